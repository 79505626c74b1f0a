"""Parameters of tracking and mapping, all for experts: the only place of their defaults."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hoid_common.config import Config, param, section
from rgbd_slam.config.consensus_config import ConsensusConfig
from rgbd_slam.config.place_config import PlaceConfig


@dataclass(frozen=True)
class CameraConfig(Config):
    """The model of the camera and its features in tracking and mapping."""

    disparity_noise_px: float = param(
        0.3,  # decision 003: 0.07 px in rendered images to 0.6 px in fr1_xyz
        'Standard deviation of a depth reading as a disparity of the virtual stereo camera '
        '(pixels), until it has been measured. A larger one accepts more outliers in depth.',
        minimum=0.01,
        maximum=10.0,
    )
    joint_noise: bool = param(
        default=False,  # decision 021: the rule of ORB-SLAM3
        description='Gives u_right the noise of u and v and applies one robust kernel to all '
        'three, as ORB-SLAM3 does. When it is off, depth has its own noise and kernel.',
        internal=True,
    )
    rolling_shutter: bool = param(
        default=True,  # decision 033; ablation: fr1_xyz by `motion` 0.0098 m without it, 0.0066 m
        description='Estimates the readout time of the image rows and compensates for it. When it '
        'is off, all rows count as taken at once, as in ORB-SLAM3.',
    )
    scale_factor: float = param(
        1.2,  # as extraction.scale_factor of the filter
        'Ratio of the scales of two successive octaves (a plain number), the same as in '
        'extraction.',
        minimum=1.01,
        maximum=2.0,
    )
    num_octaves: int = param(
        8,  # as extraction.num_levels of the filter
        'Number of octaves, at least the number of levels in extraction.',
        minimum=1,
        maximum=16,
    )

    # Baseline of the virtual stereo camera that stands for the depth camera (m) (a Kinect's
    # distance of projector and camera (0.077 in ORB-SLAM3's TUM1.yaml)).
    baseline_m: ClassVar[float] = 0.075
    # ORB-SLAM3, TUM1.yaml, Stereo.ThDepth: number of baselines up to which a depth reading alone
    # creates a map point. Points that are farther away are noisy.
    close_baselines: ClassVar[float] = 40.0
    # Not tuned: standard deviation of the scale of depth readings, as a share of the disparity.
    relative_depth_noise: ClassVar[float] = 0.03

    @property
    def close_limit_m(self) -> float:
        """Return the depth [m] up to which a reading alone creates a map point."""
        return self.close_baselines * self.baseline_m


@dataclass(frozen=True)
class TrackingConfig(Config):
    """Estimation of the pose of one image from its features."""

    few_matches: int = param(
        40,  # not tuned; ORB-SLAM3 has 20 (Tracking.cc, TrackWithMotionModel)
        'Number of matches with the last frame below which the search window is widened. A larger '
        'number widens it more often, which takes time.',
        minimum=4,
        maximum=1000,
        internal=True,
    )
    few_points: int = param(
        100,  # ORB-SLAM3, in localization (Tracking.cc, UpdateLastFrame)
        'Number of map points in the last frame below which its depth readings are matched as '
        'well. A larger number uses them more often, where a moving object may be among them.',
        minimum=0,
        maximum=5000,
        internal=True,
    )
    convincing_share: float = param(
        0.5,  # not tuned
        'Share of the matches that must be inliers, unless as large a share of the last points is '
        'seen again; otherwise further pose hypotheses are tried. A larger share tries them more '
        'often, which takes time.',
        minimum=0.0,
        maximum=1.0,
        internal=True,
    )
    max_local_keyframes: int = param(
        24,  # chosen: ORB-SLAM3 has 80, which takes longer
        'Number of keyframes whose points make up the local map. A larger number matches more '
        'points and takes more time.',
        minimum=2,
        maximum=500,
        internal=True,
    )
    reference_max_hamming: int = param(
        60,  # not tuned; ORB-SLAM3 has 50 (ORBmatcher.cc, TH_LOW)
        'Largest descriptor distance of a match with the reference keyframe (bits). A larger one '
        'gives more matches, of which more are wrong.',
        minimum=1,
        maximum=256,
        internal=True,
    )
    reference_ratio: float = param(
        0.8,  # not tuned; ORB-SLAM3 has 0.7 (Tracking.cc, TrackReferenceKeyFrame)
        'Largest ratio of the best to the second best descriptor distance of a match with the '
        'reference keyframe, as a share. A larger ratio gives more matches, of which more are '
        'wrong.',
        minimum=0.1,
        maximum=1.0,
        internal=True,
    )
    consensus: ConsensusConfig = section(ConsensusConfig)

    # ORB-SLAM3, Tracking.cc, TrackWithMotionModel: radius of the search in octave 0, and doubled.
    last_frame_radius_px: ClassVar[float] = 15.0
    wide_radius_px: ClassVar[float] = 30.0
    local_map_radius: ClassVar[float] = 3.0  # ORB-SLAM3, Tracking.cc, SearchLocalPoints, RGB-D
    local_map_ratio: ClassVar[float] = 0.8  # as there: best to second best distance, same octave
    max_hamming: ClassVar[int] = 100  # ORB-SLAM3, ORBmatcher.cc, TH_HIGH [bits]
    # Chosen: speeds of the camera that a match with the reference keyframe may imply: twice the
    # speed of walking, and a hand-held camera that is turned as fast as possible.
    max_speed_mps: ClassVar[float] = 3.0
    max_turn_dps: ClassVar[float] = 400.0
    # Not tuned: matches with the reference keyframe are used only if the last frame was tracked
    # within this time, and if the motion exceeds these speeds by no more than these jumps.
    reference_within_s: ClassVar[float] = 0.4
    jump_m: ClassVar[float] = 0.1
    jump_deg: ClassVar[float] = 10.0
    # Number of inliers below which a frame is not tracked. A larger number gives up earlier, a
    # smaller one accepts worse poses (ORB-SLAM3, Tracking.cc, TrackLocalMap).
    min_inliers: ClassVar[int] = 30


@dataclass(frozen=True)
class KeyframeConfig(Config):
    """When a frame becomes a keyframe (decision 004)."""

    reference_share: float = param(
        0.75,  # ORB-SLAM3, Tracking.cc, NeedNewKeyFrame
        'A frame becomes a keyframe if it sees less than this share of the points of its '
        'reference keyframe. A larger share makes more keyframes.',
        minimum=0.1,
        maximum=1.0,
        read_only=False,
    )
    min_close_tracked: int = param(
        60,  # not tuned; ORB-SLAM3 has 100 (Tracking.cc, NeedNewKeyFrame)
        'A frame that tracks less than this number of near points, and could add many, becomes a '
        'keyframe. A larger number makes more keyframes.',
        minimum=0,
        maximum=5000,
        internal=True,
    )
    min_gap_s: float = param(
        0.2,  # not tuned; ORB-SLAM3 has 0
        'Shortest time between two keyframes while tracking is good (s). A longer time makes '
        'fewer keyframes.',
        minimum=0.0,
        maximum=10.0,
        read_only=False,
    )
    fewer_share: float = param(
        0.85,  # decision 004
        'A frame with a new view becomes a keyframe if it sees less than this share of the points '
        'tracked after the last keyframe. A larger share makes more keyframes.',
        minimum=0.0,
        maximum=1.0,
        internal=True,
    )
    fallen_share: float = param(
        0.6,  # not tuned
        'A frame becomes a keyframe at once, even with a known view, if it sees less than this '
        'share of the points tracked after the last keyframe. A larger share makes more '
        'keyframes.',
        minimum=0.0,
        maximum=1.0,
        internal=True,
    )
    skip_known_views: bool = param(
        default=True,  # decision 004: 39 keyframes after one pass over a path, 43 after 136 passes
        description='Makes no keyframe where the map already has the same view, so that the map '
        'does not grow with time. ORB-SLAM3 has no such rule.',
    )
    keep_outliers: bool = param(
        default=False,  # decision 021: the rule of ORB-SLAM3
        description='Stores the outliers of the pose in the keyframe as well and leaves their '
        'rejection to bundle adjustment, as ORB-SLAM3 does.',
        internal=True,
    )
    min_new_points: int = param(
        400,  # not tuned; ORB-SLAM3 has 100 (Tracking.cc, CreateNewKeyFrame)
        'Number of points with depth that a keyframe must have, if need be from beyond '
        'camera.close_baselines. A larger number makes a denser map with more distant points.',
        minimum=0,
        maximum=5000,
        internal=True,
    )

    # ORB-SLAM3, Tracking.cc, NeedNewKeyFrame: so many near features without a point are many.
    min_close_new: ClassVar[int] = 70


@dataclass(frozen=True)
class TriangulationConfig(Config):
    """Creation of points from two keyframes (decision 009)."""

    neighbors: int = param(
        6,  # decision 009
        'Number of keyframes to triangulate with; 0 creates points from depth only. A larger '
        'number creates more points and takes more time.',
        minimum=0,
        maximum=50,
        internal=True,
    )
    min_baseline_m: float = param(
        0.03,  # not tuned; ORB-SLAM3 asks for a stereo baseline
        'Shortest distance between two keyframes that are triangulated (m). A longer one skips '
        'more pairs, whose points would be inaccurate.',
        minimum=0.0,
        maximum=10.0,
        internal=True,
    )
    min_parallax_deg: float = param(
        0.6,  # not tuned; ORB-SLAM3 asks for 1.15 degrees (cosine of 0.9998)
        'Smallest angle between the two rays to a new point (degrees). A larger angle creates '
        'fewer and more accurate points.',
        minimum=0.01,
        maximum=30.0,
        internal=True,
    )
    ratio: float = param(
        0.9,  # not tuned; ORB-SLAM3 has 0.6 (LocalMapping.cc, CreateNewMapPoints)
        'Largest ratio of the best to the second best descriptor distance of a match to be '
        'triangulated, as a share. A larger ratio gives more points, of which more are wrong.',
        minimum=0.1,
        maximum=1.0,
        internal=True,
    )

    min_depth_m: ClassVar[float] = 0.4  # the shortest range of depth cameras (decision 009)
    max_hamming: ClassVar[int] = 50  # ORB-SLAM3, ORBmatcher.cc, TH_LOW [bits]


@dataclass(frozen=True)
class MappingConfig(Config):
    """Local mapping: what follows the insertion of a keyframe."""

    window: int = param(
        8,  # chosen: ORB-SLAM3 moves all covisible keyframes, which takes longer
        'Number of keyframes that local bundle adjustment moves. A larger number spreads '
        'corrections over more keyframes and takes more time.',
        minimum=2,
        maximum=100,
        internal=True,
    )
    fixed_window: int = param(
        12,  # chosen: ORB-SLAM3 takes all keyframes that see the points
        'Number of further keyframes that local bundle adjustment keeps fixed. A larger number '
        'ties the window to more of the map and takes more time.',
        minimum=1,
        maximum=200,
        internal=True,
    )
    rounds: int = param(
        2,  # not tuned; ORB-SLAM3 has one
        'Number of rounds of local bundle adjustment; outliers of a round are left out of the '
        'next one. A larger number rejects outliers better and takes more time.',
        minimum=1,
        maximum=5,
        internal=True,
    )
    iterations: int = param(
        5,  # ORB-SLAM's first round (Optimizer.cc); ORB-SLAM3 has ten in one round
        'Largest number of iterations in each round. A larger number converges further and takes '
        'more time.',
        minimum=1,
        maximum=50,
        internal=True,
    )
    redundant_share: float = param(
        0.8,  # not tuned; ORB-SLAM3 has 0.9 (LocalMapping.cc, KeyFrameCulling)
        'A keyframe is removed if three others see at least this share of its points. A larger '
        'share keeps more keyframes.',
        minimum=0.5,
        maximum=1.0,
        internal=True,
    )
    triangulation: TriangulationConfig = section(TriangulationConfig)

    fuse_radius_px: ClassVar[float] = 3.0  # ORB-SLAM3, ORBmatcher.h, Fuse
    max_hamming: ClassVar[int] = 50  # ORB-SLAM3, ORBmatcher.cc, TH_LOW [bits]
    # ORB-SLAM3, LocalMapping.cc, MapPointCulling: a new point is removed if it is found in less
    # than this share of the frames that should see it.
    min_found_ratio: ClassVar[float] = 0.25
    # Number of keyframes with which a keyframe's points are fused. A larger number finds more
    # duplicates and takes more time (ORB-SLAM3, LocalMapping.cc, SearchInNeighbors).
    neighbors: ClassVar[int] = 10


@dataclass(frozen=True)
class SlamConfig(Config):
    """All parameters of the core."""

    seed: int = param(
        0, 'Number that seeds all random sampling, so that runs repeat.', minimum=0, expert=True
    )
    camera: CameraConfig = section(CameraConfig, expert=True)
    tracking: TrackingConfig = section(TrackingConfig, expert=True)
    keyframes: KeyframeConfig = section(KeyframeConfig, expert=True)
    mapping: MappingConfig = section(MappingConfig, expert=True)
    places: PlaceConfig = section(PlaceConfig, expert=True)
