"""Parameters of tracking and mapping, all for experts: the only place of their defaults."""

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
    """The model of the camera and its features in tracking and mapping."""

    disparity_noise_px: float = param(
        0.3,  # decision 003: 0.07 px in rendered images to 0.6 px in fr1_xyz
        'Constant part of the standard deviation of depth readings, as disparity of a stereo '
        'camera with a baseline of 7.5 cm (pixels); 3 % of the disparity are added in quadrature. '
        'Both are scaled by the noise that is measured in the images. Raise it for a camera with '
        'noisier depth.',
        limits=(0.01, 10.0),
    )
    # Whether u_right, the column in the right image of the virtual stereo camera, has the same
    # noise as u and v and shares one robust kernel with them, as in ORB-SLAM3. When it is off,
    # depth has its own noise and robust kernel. ORB-SLAM3 has it on (decision 021).
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

    # Baseline (m) of the virtual stereo camera that stands for the depth camera: the distance
    # between projector and camera of a Kinect (0.077 in ORB-SLAM3's TUM1.yaml).
    baseline_m: ClassVar[float] = 0.075
    # ORB-SLAM3, TUM1.yaml, Stereo.ThDepth: number of baselines up to which a depth alone
    # creates a map point. Points that are farther away are noisy.
    close_baselines: ClassVar[float] = 40.0
    # Not tuned: part of the standard deviation of a depth reading, converted to disparity, that is
    # proportional to the disparity (see disparity_noise_px).
    relative_depth_noise: ClassVar[float] = 0.03

    @property
    def close_limit_m(self) -> float:
        """Return the depth [m] up to which its measurement alone creates a map point."""
        return self.close_baselines * self.baseline_m


@dataclass(frozen=True)
class TrackingConfig(Config):
    """Estimation of the pose of one image from its features."""

    # Number of matches with the last frame below which the search is repeated in wider windows. A
    # larger number repeats it more often, which takes time. Not tuned; ORB-SLAM3 has 20
    # (Tracking.cc, TrackWithMotionModel).
    few_matches: int = param(40, internal=True)
    # If the last frame observed fewer map points than this, its other features with depth are
    # matched as well from the first search on; otherwise only if map points alone give no
    # convincing pose. A larger number uses these features more often; some of them may be on a
    # moving object that is not in the map. Value of ORB-SLAM3 in localization (Tracking.cc,
    # UpdateLastFrame).
    few_points: int = param(100, internal=True)
    # A pose is accepted at once if its inliers are more than this share of the matches, or more
    # than this share of the points of the last frame; otherwise further pose hypotheses are
    # tried. A larger share tries them more often, which takes time. Not tuned.
    convincing_share: float = param(0.5, internal=True)
    # Number of keyframes whose points make up the local map. A larger number matches more points
    # and takes more time. Chosen: ORB-SLAM3 has 80, which takes longer.
    max_local_keyframes: int = param(24, internal=True)
    # Largest descriptor distance of a match with the reference keyframe (bits). A larger one
    # gives more matches, of which more are wrong. Not tuned; ORB-SLAM3 has 50 (ORBmatcher.cc,
    # TH_LOW).
    reference_max_hamming: int = param(60, internal=True)
    # A match with the reference keyframe is accepted if its descriptor distance is at most this
    # share of that of the second best match. A larger share gives more matches, of which more are
    # wrong. Not tuned; ORB-SLAM3 has 0.7 (Tracking.cc, TrackReferenceKeyFrame).
    reference_ratio: float = param(0.8, internal=True)
    consensus: ConsensusConfig = section(ConsensusConfig)

    # ORB-SLAM3, Tracking.cc, TrackWithMotionModel: half side of the search windows in octave 0,
    # and that of the wider windows.
    last_frame_radius_px: ClassVar[float] = 15.0
    wide_radius_px: ClassVar[float] = 30.0
    # ORB-SLAM3, Tracking.cc, SearchLocalPoints: factor on the search windows for RGB-D cameras,
    # and largest ratio of the best to the second best descriptor distance in the same octave.
    local_map_radius: ClassVar[float] = 3.0
    local_map_ratio: ClassVar[float] = 0.8
    max_hamming: ClassVar[int] = 100  # ORB-SLAM3, ORBmatcher.cc, TH_HIGH [bits]
    # Chosen: largest speeds of the camera that a pose by the reference keyframe may imply: twice
    # the speed of walking, and that of a hand-held camera that is turned as fast as possible.
    max_speed_mps: ClassVar[float] = 3.0
    max_turn_dps: ClassVar[float] = 400.0
    # Not tuned: matches with the reference keyframe are used only if the last frame was tracked at
    # most this long ago. The constants `jump_m` and `jump_deg` are added to the distance and the
    # rotation that `max_speed_mps` and `max_turn_dps` allow since then.
    reference_within_s: ClassVar[float] = 0.4
    jump_m: ClassVar[float] = 0.1
    jump_deg: ClassVar[float] = 10.0
    # Number of inliers below which a frame is not tracked; fewer are enough for a pose that agrees
    # with a gyro (`Odometry.min_inliers`). With a larger number the camera is lost earlier, with a
    # smaller one worse poses are accepted (ORB-SLAM3, Tracking.cc, TrackLocalMap).
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
    # A frame becomes a keyframe if it tracks fewer near points than this, and has many near
    # features from which new points can be created. A larger number makes more keyframes. Not
    # tuned; ORB-SLAM3 has 100 (Tracking.cc, NeedNewKeyFrame).
    min_close_tracked: int = param(60, internal=True)
    min_gap_s: float = param(
        0.2,  # not tuned; ORB-SLAM3 has 0
        'Shortest time between two keyframes while tracking is good and the mapper is in time '
        '(s). Raise it to make fewer keyframes on a slow computer.',
        limits=(0.0, 10.0),
        read_only=False,
    )
    # A frame whose view no keyframe has becomes a keyframe if it tracks fewer points than this
    # share of the most that a frame has tracked since the last keyframe. A larger share makes
    # more keyframes. Decision 004.
    fewer_share: float = param(0.85, internal=True)
    # A frame becomes a keyframe at once, even if a keyframe has the same view, if it tracks fewer
    # points than this share of the most that a frame has tracked since the last keyframe. A
    # larger share makes more keyframes. Not tuned.
    fallen_share: float = param(0.6, internal=True)
    # Whether to skip a keyframe where an older keyframe already has the same view, so that the map
    # does not grow while the robot stays in a known place (decision 004: 39 keyframes after one
    # pass over a path, 43 after 136 passes). A keyframe is still made if tracking gets worse
    # quickly, if many features have newly appeared, or if the view changes while a keyframe waits
    # for the mapper.
    skip_known_views: bool = param(default=True, internal=True)
    # Whether a keyframe also stores matches that are outliers of the pose, whose rejection is then
    # left to bundle adjustment, as in ORB-SLAM3. When it is off, a keyframe stores inliers only.
    # ORB-SLAM3 has it on (decision 021).
    keep_outliers: bool = param(default=False, internal=True)
    # Number of near points up to which a keyframe is filled with points from depth. If there are
    # too few features within 3 m, more distant ones are used, whose points are noisier. A larger
    # number makes a denser map with more distant points. Not tuned; ORB-SLAM3 has 100
    # (Tracking.cc, CreateNewKeyFrame).
    min_new_points: int = param(400, internal=True)

    # ORB-SLAM3, Tracking.cc, NeedNewKeyFrame: a keyframe can add many points if it has more near
    # features without a map point than this number.
    min_close_new: ClassVar[int] = 70


@dataclass(frozen=True)
class TriangulationConfig(Config):
    """Creation of points from two keyframes (decision 009)."""

    # Number of neighboring keyframes with which a new keyframe is triangulated. A larger number
    # creates more points and takes more time; 0 creates points from depth readings only. Decision
    # 009.
    neighbors: int = param(6, internal=True)
    # Shortest distance between two keyframes from which points are triangulated (m). A longer
    # distance creates fewer and more accurate points. Not tuned; ORB-SLAM3 asks for a stereo
    # baseline.
    min_baseline_m: float = param(0.03, internal=True)
    # Smallest angle between the two rays to a new point (degrees). A larger angle creates fewer
    # and more accurate points. Not tuned; ORB-SLAM3 asks for 1.15 degrees (cosine of 0.9998).
    min_parallax_deg: float = param(0.6, internal=True)
    # A match is triangulated if its descriptor distance is at most this share of that of the
    # second best match. A larger share creates more points, of which more are wrong. Not tuned;
    # ORB-SLAM3 has 0.6 (LocalMapping.cc, CreateNewMapPoints).
    ratio: float = param(0.9, internal=True)

    min_depth_m: ClassVar[float] = 0.4  # the shortest range of depth cameras (decision 009)
    max_hamming: ClassVar[int] = 50  # ORB-SLAM3, ORBmatcher.cc, TH_LOW [bits]


@dataclass(frozen=True)
class MappingConfig(Config):
    """Local mapping after the insertion of a keyframe: new points, adjustment and culling."""

    # Number of keyframes that local bundle adjustment moves. A larger number spreads corrections
    # over more keyframes and takes more time. Chosen: ORB-SLAM3 moves all covisible keyframes,
    # which takes longer.
    window: int = param(8, internal=True)
    # Number of further keyframes that see the same points and that local bundle adjustment keeps
    # fixed. A larger number connects the adjusted keyframes to more of the map and takes more
    # time. Chosen: ORB-SLAM3 takes all keyframes that see the points.
    fixed_window: int = param(12, internal=True)
    # Number of rounds of local bundle adjustment; outliers of a round are left out of the next
    # one. A larger number rejects outliers better and takes more time. Not tuned; ORB-SLAM3 has
    # one.
    rounds: int = param(2, internal=True)
    # Largest number of iterations in each round. A larger number converges further and takes more
    # time. Value of ORB-SLAM's first round (Optimizer.cc); ORB-SLAM3 has ten in one round.
    iterations: int = param(5, internal=True)
    # A keyframe is removed if three others see at least this share of its points. A larger share
    # keeps more keyframes. Not tuned; ORB-SLAM3 has 0.9 (LocalMapping.cc, KeyFrameCulling).
    redundant_share: float = param(0.8, internal=True)
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
