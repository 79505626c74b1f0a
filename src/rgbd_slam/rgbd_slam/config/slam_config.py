"""Parameters of tracking and mapping, all for experts; defaults are set only here."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import ClassVar

from hoid_common.config import Config, param, section
from rgbd_slam.config.consensus_config import ConsensusConfig
from rgbd_slam.config.imu_config import ImuConfig
from rgbd_slam.config.place_config import PlaceConfig


@dataclass(frozen=True)
class CameraConfig(Config):
    """The camera model and the features in tracking and mapping."""

    disparity_noise_px: float = param(
        0.3,  # decision 003: 0.07 px in rendered images to 0.6 px in fr1_xyz
        'Constant part of the standard deviation of depth readings, as disparity of a stereo '
        'camera with a baseline of 7.5 cm (pixels); 3 % of the disparity are added in quadrature. '
        'Both are scaled by the noise that is measured in the images. Raise it for a camera with '
        'noisier depth.',
        limits=(0.01, 10.0),
    )
    # Whether u_right, the column in the right image of the virtual stereo camera, has the noise of
    # u and v and shares one robust kernel with them, as in ORB-SLAM3. False: depth has its own
    # noise and robust kernel (decision 021).
    joint_noise: bool = param(default=False, internal=True)
    rolling_shutter: bool = param(
        default=True,  # decision 033; ablation: fr1_xyz by `motion` 0.0098 m without it, 0.0066 m
        description='Whether to estimate the readout time of the image rows and to compensate for '
        'it. Set it to false for a camera with a global shutter.',
    )
    scale_factor: float = param(
        1.2,  # as ExtractionConfig.scale_factor of hoid_filter
        'Ratio of the scales of two successive levels of the image pyramid (without unit). Keep '
        'it for hoid_filter; set it to that of another node that publishes features. A saved map '
        'needs the value that it was made with.',
        limits=(1.01, 2.0),
    )
    num_octaves: int = param(
        8,  # as ExtractionConfig.num_levels of hoid_filter
        'Largest number of levels of the image pyramid (octaves) from which features come. Keep '
        'it for hoid_filter; raise it for another node that publishes features of more levels. A '
        'saved map needs the number that it was made with.',
        limits=(1, 16),
    )

    # Baseline (m) of the virtual stereo camera that represents the depth camera: the distance
    # between projector and camera of a Kinect (0.077 in ORB-SLAM3's TUM1.yaml).
    baseline_m: ClassVar[float] = 0.075
    # Depth up to which a single depth reading creates a map point, in baselines; points farther
    # away are noisy (ORB-SLAM3, TUM1.yaml, Stereo.ThDepth).
    close_baselines: ClassVar[float] = 40.0
    # Proportional part of the standard deviation of a depth reading, as a ratio to its disparity;
    # `disparity_noise_px` is the constant part. Not tuned.
    relative_depth_noise: ClassVar[float] = 0.03

    @property
    def close_limit_m(self) -> float:
        """Return the depth (m) up to which a single depth reading creates a map point."""
        return self.close_baselines * self.baseline_m


@dataclass(frozen=True)
class TrackingConfig(Config):
    """How the pose of an image is estimated from its features."""

    # With fewer matches with the last frame, the search is repeated in wider windows. A larger
    # number repeats it more often, which takes time. Not tuned; ORB-SLAM3 has 20 (Tracking.cc,
    # TrackWithMotionModel).
    few_matches: int = param(40, internal=True)
    # If the last frame observed fewer map points, its other features with depth are matched too,
    # from the first search on; otherwise only if map points alone give no convincing pose. A
    # larger number uses these features more often; some of them may be on a moving object that is
    # not in the map. Value of ORB-SLAM3 in localization (Tracking.cc, UpdateLastFrame).
    few_points: int = param(100, internal=True)
    # A pose is accepted at once if its inliers are more than this ratio of the matches, or of the
    # points of the last frame; otherwise further pose hypotheses are tried. A larger ratio tries
    # them more often, which takes time. Not tuned.
    convincing_share: float = param(0.5, internal=True)
    # Number of keyframes whose points form the local map. A larger number matches more points, but
    # takes more time. Chosen: ORB-SLAM3 has 80, which takes longer.
    max_local_keyframes: int = param(24, internal=True)
    # Largest descriptor distance (bits) of a match with the reference keyframe. A larger one gives
    # more matches, but also more wrong ones. Not tuned; ORB-SLAM3 has 50 (ORBmatcher.cc, TH_LOW).
    reference_max_hamming: int = param(60, internal=True)
    # Largest ratio of the best to the second best descriptor distance of a match with the
    # reference keyframe. A larger ratio gives more matches, but also more wrong ones. Not tuned;
    # ORB-SLAM3 has 0.7 (Tracking.cc, TrackReferenceKeyFrame).
    reference_ratio: float = param(0.8, internal=True)
    consensus: ConsensusConfig = section(ConsensusConfig)

    # Half side of the search windows in octave 0, and of the wider windows (ORB-SLAM3,
    # Tracking.cc, TrackWithMotionModel).
    last_frame_radius_px: ClassVar[float] = 15.0
    wide_radius_px: ClassVar[float] = 30.0
    # Factor on the search windows for RGB-D cameras, and largest ratio of the best to the second
    # best descriptor distance in the same octave (ORB-SLAM3, Tracking.cc, SearchLocalPoints).
    local_map_radius: ClassVar[float] = 3.0
    local_map_ratio: ClassVar[float] = 0.8
    max_hamming: ClassVar[int] = 100  # ORB-SLAM3, ORBmatcher.cc, TH_HIGH [bits]
    # Chosen: largest speeds of the camera that a pose from the reference keyframe may imply: twice
    # walking speed, and the turn rate of a hand-held camera that is turned as fast as possible.
    max_speed_mps: ClassVar[float] = 3.0
    max_turn_dps: ClassVar[float] = 400.0
    # Not tuned: matches with the reference keyframe are used only if the last frame was tracked
    # within this time. Since then, the camera may have moved by `jump_m` and `jump_deg` plus what
    # `max_speed_mps` and `max_turn_dps` allow.
    reference_within_s: ClassVar[float] = 0.4
    jump_m: ClassVar[float] = 0.1
    jump_deg: ClassVar[float] = 10.0
    # Least number of inliers of a tracked frame; fewer suffice for a pose that agrees with a gyro
    # (`Odometry.min_inliers`). With a larger number the camera is lost earlier, with a smaller one
    # worse poses are accepted (ORB-SLAM3, Tracking.cc, TrackLocalMap).
    min_inliers: ClassVar[int] = 30


@dataclass(frozen=True)
class KeyframeConfig(Config):
    """When a frame becomes a keyframe (decision 004)."""

    reference_share: float = param(
        0.75,  # ORB-SLAM3, Tracking.cc, NeedNewKeyFrame
        'A frame becomes a keyframe if it tracks fewer map points than this share of the '
        'confirmed points of its reference keyframe (0.4 of them while the map has at most two '
        'keyframes). Raise it if the camera is often lost in fast motion; more keyframes take '
        'more time and memory.',
        limits=(0.1, 1.0),
        read_only=False,
    )
    # A frame becomes a keyframe if it tracks fewer near points, and has many near features from
    # which new points can be created. A larger number makes more keyframes. Not tuned; ORB-SLAM3
    # has 100 (Tracking.cc, NeedNewKeyFrame).
    min_close_tracked: int = param(60, internal=True)
    min_gap_s: float = param(
        0.2,  # not tuned; ORB-SLAM3 has 0
        'Shortest time between two keyframes while tracking is good and the mapper is in time '
        '(s). Raise it to make fewer keyframes on a slow computer.',
        limits=(0.0, 10.0),
        read_only=False,
    )
    # A frame with a view that no keyframe has becomes a keyframe if the number of points that it
    # tracks is below this ratio of the largest number since the last keyframe. A larger ratio
    # makes more keyframes (decision 004).
    fewer_share: float = param(0.85, internal=True)
    # A frame becomes a keyframe even if another keyframe has the same view, if the number of
    # points that it tracks is below this ratio of the largest number since the last keyframe. A
    # larger ratio makes more keyframes. Not tuned.
    fallen_share: float = param(0.6, internal=True)
    # Whether a frame does not become a keyframe if an older keyframe has the same view, so that
    # the map does not grow while the robot stays in a known place (decision 004: 39 keyframes
    # after one pass over a path, 43 after 136 passes). It still becomes one if tracking suddenly
    # gets worse, if many features are new, or if the view changes while a keyframe waits for the
    # mapper.
    skip_known_views: bool = param(default=True, internal=True)
    # Whether a keyframe also stores matches that are outliers of the pose, so that bundle
    # adjustment rejects them, as in ORB-SLAM3. False: a keyframe stores inliers only (decision
    # 021).
    keep_outliers: bool = param(default=False, internal=True)
    # A keyframe is filled up to this number of near points with points from depth. If there are
    # too few features within 3 m, more distant ones are used, whose points are noisier. A larger
    # number makes a denser map with more distant points. Not tuned; ORB-SLAM3 has 100
    # (Tracking.cc, CreateNewKeyFrame).
    min_new_points: int = param(400, internal=True)

    # A keyframe can add many points if it has more near features without a map point than this
    # (ORB-SLAM3, Tracking.cc, NeedNewKeyFrame).
    min_close_new: ClassVar[int] = 70


@dataclass(frozen=True)
class TriangulationConfig(Config):
    """Creation of points from two keyframes (decision 009)."""

    # Number of neighboring keyframes with which a new keyframe is triangulated. A larger number
    # creates more points, but takes more time; with 0, points are created from depth only
    # (decision 009).
    neighbors: int = param(6, internal=True)
    # Points are triangulated from two keyframes if these are at least this far apart (m). A longer
    # distance creates fewer, but more accurate points. Not tuned; ORB-SLAM3 requires a stereo
    # baseline.
    min_baseline_m: float = param(0.03, internal=True)
    # Smallest angle (degrees) between the two rays to a new point. A larger angle creates fewer,
    # but more accurate points. Not tuned; ORB-SLAM3 requires 1.15 degrees (cosine of 0.9998).
    min_parallax_deg: float = param(0.6, internal=True)
    # Largest ratio of the best to the second best descriptor distance of a match that is
    # triangulated. A larger ratio creates more points, but also more wrong ones. Not tuned;
    # ORB-SLAM3 has 0.6 (LocalMapping.cc, CreateNewMapPoints).
    ratio: float = param(0.9, internal=True)

    min_depth_m: ClassVar[float] = 0.4  # shortest range of depth cameras (decision 009)
    max_hamming: ClassVar[int] = 50  # ORB-SLAM3, ORBmatcher.cc, TH_LOW [bits]


@dataclass(frozen=True)
class MappingConfig(Config):
    """Local mapping after the insertion of a keyframe: new points, adjustment and culling."""

    # Number of keyframes that local bundle adjustment moves. A larger number spreads corrections
    # over more keyframes, but takes more time. Chosen: ORB-SLAM3 moves all covisible keyframes,
    # which takes longer.
    window: int = param(8, internal=True)
    # Number of further keyframes with the same points that local bundle adjustment keeps fixed. A
    # larger number connects the adjusted keyframes to more of the map, but takes more time.
    # Chosen: ORB-SLAM3 keeps all keyframes with these points fixed.
    fixed_window: int = param(12, internal=True)
    # Number of rounds of local bundle adjustment; outliers of a round are left out of the next
    # one. A larger number rejects outliers better, but takes more time. Not tuned; ORB-SLAM3 has
    # one.
    rounds: int = param(2, internal=True)
    # Largest number of iterations per round. A larger number converges further, but takes more
    # time. Value of ORB-SLAM's first round (Optimizer.cc); ORB-SLAM3 has ten in one round.
    iterations: int = param(5, internal=True)
    # A keyframe is removed if three others observe at least this ratio of its points. A larger
    # ratio keeps more keyframes. Not tuned; ORB-SLAM3 has 0.9 (LocalMapping.cc, KeyFrameCulling).
    redundant_share: float = param(0.8, internal=True)
    triangulation: TriangulationConfig = section(TriangulationConfig)

    fuse_radius_px: ClassVar[float] = 3.0  # ORB-SLAM3, ORBmatcher.h, Fuse
    max_hamming: ClassVar[int] = 50  # ORB-SLAM3, ORBmatcher.cc, TH_LOW [bits]
    # A new point is removed if it is found in less than this ratio of the frames that should show
    # it (ORB-SLAM3, LocalMapping.cc, MapPointCulling).
    min_found_ratio: ClassVar[float] = 0.25
    # Number of keyframes with which the points of a keyframe are fused. A larger number finds more
    # duplicates, but takes more time (ORB-SLAM3, LocalMapping.cc, SearchInNeighbors).
    neighbors: ClassVar[int] = 10


@dataclass(frozen=True)
class SlamConfig(Config):
    """All parameters of SLAM without its ROS node."""

    seed: int = param(
        0,
        'Number that seeds the random samples of RANSAC, which estimates poses from matches.',
        limits=(0, inf),
        expert=True,
    )
    camera: CameraConfig = section(CameraConfig, expert=True)
    tracking: TrackingConfig = section(TrackingConfig, expert=True)
    keyframes: KeyframeConfig = section(KeyframeConfig, expert=True)
    mapping: MappingConfig = section(MappingConfig, expert=True)
    places: PlaceConfig = section(PlaceConfig, expert=True)
    imu: ImuConfig = section(ImuConfig, expert=True)
