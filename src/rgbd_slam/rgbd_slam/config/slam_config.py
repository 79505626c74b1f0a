"""Parameters of tracking and mapping: the only place of their defaults."""

from __future__ import annotations

from dataclasses import dataclass, field

from hoid_common.config import Config, param
from rgbd_slam.config.consensus_config import ConsensusConfig
from rgbd_slam.config.place_config import AlignmentConfig, PlaceConfig


@dataclass(frozen=True)
class CameraConfig(Config):
    """How the optimisers see the camera and its features."""

    baseline_m: float = param(
        0.075, 'Baseline of the virtual stereo pair that stands for depth', minimum=0.001,
        maximum=1.0,
    )  # fmt: skip
    disparity_noise_px: float = param(
        0.3, 'Standard deviation of a depth reading, as a disparity of that pair', minimum=0.01,
        maximum=10.0,
    )  # fmt: skip
    relative_depth_noise: float = param(
        0.03, 'Part of it that grows with the disparity: scale errors', minimum=0.0, maximum=0.5
    )
    joint_noise: bool = param(
        False,
        'ORB-SLAM: u_right is as noisy as u and v, and one robust kernel spans the three; '
        'otherwise depth readings have a noise and a kernel of their own',
    )
    close_baselines: float = param(
        40.0, 'Depth is trusted to make points up to this many baselines', minimum=1.0,
        maximum=1000.0,
    )  # fmt: skip
    scale_factor: float = param(
        1.2, 'Scale between two octaves, as in extraction', minimum=1.01, maximum=2.0
    )
    num_octaves: int = param(
        8, 'Octaves: at least the levels of extraction', minimum=1, maximum=16
    )

    @property
    def close_limit_m(self) -> float:
        """Return the depth up to which readings are trusted to make points."""
        return self.close_baselines * self.baseline_m


@dataclass(frozen=True)
class TrackingConfig(Config):
    """From the features of one image to its pose."""

    last_frame_radius_px: float = param(
        15.0, 'Search window around points of the last frame, at octave 0', minimum=1.0,
        maximum=200.0,
    )  # fmt: skip
    wide_radius_px: float = param(
        30.0, 'The same, tried again when matches are few', minimum=1.0, maximum=400.0
    )
    few_matches: int = param(40, 'Fewer matches than this are few', minimum=4, maximum=1000)
    few_points: int = param(
        100, 'With fewer map points in the last frame its depth readings help', minimum=0,
        maximum=5000,
    )  # fmt: skip
    local_map_radius: float = param(
        3.0, 'Search window around points of the local map, in units of ORB-SLAM', minimum=0.5,
        maximum=20.0,
    )  # fmt: skip
    max_hamming: int = param(
        100, 'Descriptors that differ by more never match', minimum=1, maximum=256
    )
    local_map_ratio: float = param(
        0.8, 'Best over second best distance, same octave', minimum=0.1, maximum=1.0
    )
    min_inliers: int = param(30, 'With fewer the frame is not tracked', minimum=4, maximum=1000)
    convincing_share: float = param(
        0.5, 'With fewer matches fitting, and fewer points than before, more is tried',
        minimum=0.0, maximum=1.0,
    )  # fmt: skip
    max_local_keyframes: int = param(
        24, 'Keyframes whose points make the local map', minimum=2, maximum=500
    )
    reference_max_hamming: int = param(
        60, 'Of matches with the reference keyframe by descriptors alone', minimum=1, maximum=256
    )
    reference_ratio: float = param(
        0.8, 'Best over second best distance of these', minimum=0.1, maximum=1.0
    )
    reference_within_s: float = param(
        0.4, 'They are believed when the last frame was tracked not longer ago than this,',
        minimum=0.0, maximum=10.0,
    )  # fmt: skip
    jump_m: float = param(
        0.1, 'and the camera can have moved so far, at once,', minimum=0.0, maximum=10.0
    )
    max_speed_mps: float = param(3.0, 'and for each second since', minimum=0.0, maximum=100.0)
    jump_deg: float = param(10.0, 'and turned so far, at once,', minimum=0.0, maximum=180.0)
    max_turn_dps: float = param(400.0, 'and for each second since', minimum=0.0, maximum=5000.0)
    alignment: AlignmentConfig = field(default_factory=AlignmentConfig)
    consensus: ConsensusConfig = field(default_factory=ConsensusConfig)


@dataclass(frozen=True)
class KeyframeConfig(Config):
    """When a frame becomes a keyframe."""

    reference_share: float = param(
        0.75, 'Insert when fewer of the reference keyframe\'s points are tracked', minimum=0.1,
        maximum=1.0, read_only=False,
    )  # fmt: skip
    min_close_tracked: int = param(
        60,
        'Insert when fewer close points are tracked and many could be',
        minimum=0,
        maximum=5000,
    )
    min_close_new: int = param(
        70, 'Close features without a point that count as many', minimum=0, maximum=5000
    )
    min_gap_s: float = param(
        0.2, 'None so soon after the last one, while tracking is good', minimum=0.0, maximum=10.0,
        read_only=False,
    )  # fmt: skip
    fewer_share: float = param(
        0.85, 'Insert with less of the points tracked after the last one, in a view that is new',
        minimum=0.0, maximum=1.0, read_only=False,
    )  # fmt: skip
    fallen_share: float = param(
        0.6, 'Insert at once with less of them, in a known view, too', minimum=0.0,
        maximum=1.0, read_only=False,
    )  # fmt: skip
    skip_known_views: bool = param(
        True, 'None where the map shows the same view, so that it does not grow with time'
    )
    keep_outliers: bool = param(
        False, 'ORB-SLAM: matches that do not fit the pose go with it, for adjustment to judge'
    )
    min_new_points: int = param(
        400, 'Depth points to make in a keyframe even beyond the close limit', minimum=0,
        maximum=5000,
    )  # fmt: skip


@dataclass(frozen=True)
class TriangulationConfig(Config):
    """New points from two keyframes."""

    neighbours: int = param(
        6, 'Keyframes to triangulate with; 0: points from depth only', minimum=0, maximum=50
    )
    min_baseline_m: float = param(
        0.03, 'Keyframes nearer than this are not used', minimum=0.0, maximum=10.0
    )
    min_parallax_deg: float = param(
        0.6, 'Angle between two rays that tells a depth', minimum=0.01, maximum=30.0
    )
    min_depth_m: float = param(
        0.4, 'Nothing without a depth reading is nearer', minimum=0.05, maximum=10.0
    )
    max_hamming: int = param(50, 'Bits by which a match may differ', minimum=1, maximum=256)
    ratio: float = param(0.9, 'Best over second best distance', minimum=0.1, maximum=1.0)


@dataclass(frozen=True)
class MappingConfig(Config):
    """What is done with a keyframe."""

    neighbours: int = param(10, 'Keyframes into which points are fused', minimum=1, maximum=100)
    fuse_radius_px: float = param(3.0, 'Search window of fusing', minimum=0.5, maximum=20.0)
    max_hamming: int = param(50, 'Of fusing', minimum=1, maximum=256)
    window: int = param(8, 'Keyframes that local bundle adjustment moves', minimum=2, maximum=100)
    fixed_window: int = param(
        12, 'Keyframes that it holds and whose observations it uses', minimum=1, maximum=200
    )
    rounds: int = param(
        2, 'Of local bundle adjustment; what does not fit is left out of the next one', minimum=1,
        maximum=5,
    )  # fmt: skip
    iterations: int = param(5, 'Of each round, at most', minimum=1, maximum=50)
    min_found_ratio: float = param(
        0.25, 'Young points tracked in less of the frames that should see them go', minimum=0.0,
        maximum=1.0,
    )  # fmt: skip
    redundant_share: float = param(
        0.8, 'A keyframe goes when so much of it is seen by three others as well', minimum=0.5,
        maximum=1.0,
    )  # fmt: skip
    triangulation: TriangulationConfig = TriangulationConfig()


@dataclass(frozen=True)
class SlamConfig(Config):
    """All of it."""

    seed: int = param(0, 'Of everything that samples at random', minimum=0)
    camera: CameraConfig = CameraConfig()
    tracking: TrackingConfig = TrackingConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    mapping: MappingConfig = MappingConfig()
    places: PlaceConfig = field(default_factory=PlaceConfig)
