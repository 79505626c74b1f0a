"""Parameters of tracking and mapping, all for experts: the only place of their defaults."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hoid_common.config import Config, param, section
from rgbd_slam.config.consensus_config import ConsensusConfig
from rgbd_slam.config.place_config import AlignmentConfig, PlaceConfig


@dataclass(frozen=True)
class CameraConfig(Config):
    """How the optimisers see the camera and its features."""

    baseline_m: float = param(
        0.075, 'Baseline of the virtual stereo pair that stands for depth (m).',
        minimum=0.001, maximum=1.0,
    )  # fmt: skip
    disparity_noise_px: float = param(
        0.3, 'Standard deviation of a depth reading, as a disparity of that pair (pixels).',
        minimum=0.01, maximum=10.0,
    )  # fmt: skip
    relative_depth_noise: float = param(
        0.03, 'Standard deviation of the scale of depth, as a share of the disparity.',
        minimum=0.0, maximum=0.5,
    )  # fmt: skip
    joint_noise: bool = param(
        default=False,
        description='Takes u_right to be as noisy as u and v, with one robust kernel over the '
        'three, as ORB-SLAM3 does; otherwise depth has a noise and a kernel of its own.',
    )
    rolling_shutter: bool = param(
        default=True,
        description='Measures how long the rows of an image take, and takes it out of what is '
        'tracked; false leaves images as they are, as ORB-SLAM3 does.',
    )
    close_baselines: float = param(
        40.0, 'Number of baselines up to which depth is trusted to make points.',
        minimum=1.0, maximum=1000.0,
    )  # fmt: skip
    scale_factor: float = param(
        1.2, 'Ratio of the scales of two octaves, a plain number, as in extraction.',
        minimum=1.01, maximum=2.0,
    )  # fmt: skip
    num_octaves: int = param(
        8, 'Number of octaves, at least the levels of extraction.', minimum=1, maximum=16
    )

    @property
    def close_limit_m(self) -> float:
        """Return the depth up to which readings are trusted to make points."""
        return self.close_baselines * self.baseline_m


@dataclass(frozen=True)
class TrackingConfig(Config):
    """From the features of one image to its pose."""

    few_matches: int = param(
        40, 'Number of matches below which the search window is widened.', minimum=4, maximum=1000
    )
    few_points: int = param(
        100, 'Number of map points in the last frame below which its depth readings help.',
        minimum=0, maximum=5000,
    )  # fmt: skip
    min_inliers: int = param(
        30, 'Number of matches below which the frame is not tracked.', minimum=4, maximum=1000
    )
    convincing_share: float = param(
        0.5, 'Share of fitting matches below which, with fewer points than before, more is tried.',
        minimum=0.0, maximum=1.0,
    )  # fmt: skip
    max_local_keyframes: int = param(
        24, 'Number of keyframes whose points make the local map.', minimum=2, maximum=500
    )
    reference_max_hamming: int = param(
        60, 'Largest distance of a match with the reference keyframe by descriptors alone (bits).',
        minimum=1, maximum=256,
    )  # fmt: skip
    reference_ratio: float = param(
        0.8, 'Largest ratio of the best to the second best distance of such a match, a share.',
        minimum=0.1, maximum=1.0,
    )  # fmt: skip
    max_speed_mps: float = param(
        3.0, 'Fastest that the camera can move where such matches are believed (m/s).',
        minimum=0.0, maximum=100.0,
    )  # fmt: skip
    max_turn_dps: float = param(
        400.0, 'Fastest that the camera can turn where such matches are believed (degrees/s).',
        minimum=0.0, maximum=5000.0,
    )  # fmt: skip
    alignment: AlignmentConfig = section(AlignmentConfig)
    consensus: ConsensusConfig = section(ConsensusConfig)

    # Search windows around points of the last frame at octave 0, and when matches are few.
    last_frame_radius_px: ClassVar[float] = 15.0
    wide_radius_px: ClassVar[float] = 30.0
    local_map_radius: ClassVar[float] = 3.0  # search window of the local map, as in ORB-SLAM
    local_map_ratio: ClassVar[float] = 0.8  # best over second best distance, same octave
    max_hamming: ClassVar[int] = 100  # descriptors that differ by more bits never match
    # Reference matches are believed when the last frame was tracked not longer ago than this, and
    # the camera moved no more at once than this, beside its largest speed.
    reference_within_s: ClassVar[float] = 0.4
    jump_m: ClassVar[float] = 0.1
    jump_deg: ClassVar[float] = 10.0


@dataclass(frozen=True)
class KeyframeConfig(Config):
    """When a frame becomes a keyframe."""

    reference_share: float = param(
        0.75, "Share of the reference keyframe's points; one is made when fewer are tracked.",
        minimum=0.1, maximum=1.0, read_only=False,
    )  # fmt: skip
    min_close_tracked: int = param(
        60, 'Number of close points; one is made when fewer are tracked and many could be.',
        minimum=0, maximum=5000,
    )  # fmt: skip
    min_gap_s: float = param(
        0.2, 'Shortest time between two keyframes while tracking is good (s).',
        minimum=0.0, maximum=10.0, read_only=False,
    )  # fmt: skip
    fewer_share: float = param(
        0.85, 'Share of the points tracked after the last keyframe; with fewer in a new view, one '
        'is made.', minimum=0.0, maximum=1.0, read_only=False,
    )  # fmt: skip
    fallen_share: float = param(
        0.6, 'Share of the same points; with fewer, one is made at once, in a known view, too.',
        minimum=0.0, maximum=1.0, read_only=False,
    )  # fmt: skip
    skip_known_views: bool = param(
        default=True,
        description='Makes none where the map shows the same view, so that it does not grow with '
        'time; ORB-SLAM3 has no such rule.',
    )
    keep_outliers: bool = param(
        default=False,
        description='Keeps matches that do not fit the pose, for adjustment to judge, as '
        'ORB-SLAM3 does.',
    )
    min_new_points: int = param(
        400, 'Number of depth points to make in a keyframe even beyond the close limit.',
        minimum=0, maximum=5000,
    )  # fmt: skip

    min_close_new: ClassVar[int] = 70  # close features without a point that count as many


@dataclass(frozen=True)
class TriangulationConfig(Config):
    """New points from two keyframes."""

    neighbours: int = param(
        6, 'Number of keyframes to triangulate with; 0 makes points from depth only.',
        minimum=0, maximum=50,
    )  # fmt: skip
    min_baseline_m: float = param(
        0.03, 'Distance below which two keyframes are not used (m).', minimum=0.0, maximum=10.0
    )
    min_parallax_deg: float = param(
        0.6, 'Angle between two rays that tells a depth (degrees).', minimum=0.01, maximum=30.0
    )
    ratio: float = param(
        0.9, 'Largest ratio of the best to the second best distance of a match, a share.',
        minimum=0.1, maximum=1.0,
    )  # fmt: skip

    min_depth_m: ClassVar[float] = 0.4  # nothing without a depth reading is nearer
    max_hamming: ClassVar[int] = 50  # bits by which a match may differ


@dataclass(frozen=True)
class MappingConfig(Config):
    """What is done with a keyframe."""

    neighbours: int = param(
        10, 'Number of keyframes into which points are fused.', minimum=1, maximum=100
    )
    window: int = param(
        8, 'Number of keyframes that local bundle adjustment moves.', minimum=2, maximum=100
    )
    fixed_window: int = param(
        12, 'Number of keyframes that it holds and whose observations it uses.',
        minimum=1, maximum=200,
    )  # fmt: skip
    rounds: int = param(
        2, 'Number of its rounds; what does not fit is left out of the next one.',
        minimum=1, maximum=5,
    )  # fmt: skip
    iterations: int = param(
        5, 'Number of iterations of each round, at most.', minimum=1, maximum=50
    )
    redundant_share: float = param(
        0.8, 'Share of a keyframe that three others must see as well for it to go.',
        minimum=0.5, maximum=1.0,
    )  # fmt: skip
    triangulation: TriangulationConfig = section(TriangulationConfig)

    fuse_radius_px: ClassVar[float] = 3.0  # search window of fusing
    max_hamming: ClassVar[int] = 50  # bits by which a match of fusing may differ
    # Young points tracked in less of the frames that should see them go.
    min_found_ratio: ClassVar[float] = 0.25


@dataclass(frozen=True)
class SlamConfig(Config):
    """All of it."""

    seed: int = param(
        0, 'Number that seeds everything which samples at random.', minimum=0, expert=True
    )
    camera: CameraConfig = section(CameraConfig, expert=True)
    tracking: TrackingConfig = section(TrackingConfig, expert=True)
    keyframes: KeyframeConfig = section(KeyframeConfig, expert=True)
    mapping: MappingConfig = section(MappingConfig, expert=True)
    places: PlaceConfig = section(PlaceConfig, expert=True)
