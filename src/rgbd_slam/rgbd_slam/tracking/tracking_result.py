"""The result of tracking a frame."""

from __future__ import annotations

from dataclasses import dataclass, field

from hoid_common.slam_status import SlamState
from hoid_common.values import FloatArray
from rgbd_slam.optimize.pose_consensus import CompetingMotion
from rgbd_slam.tracking.tracker import TrackerOutput


@dataclass(frozen=True, eq=False)
class TrackingResult:
    """The pose of one frame, its covariances and the tracking statistics.

    Poses and covariances are None before a map is started, and while the camera is lost without a
    motion source.
    """

    stamp_ns: int
    state: SlamState
    # (4, 4) in the core's map frame; jumps if the map is corrected.
    T_map_camera: FloatArray | None = None
    # (4, 4) in the core's odometry frame, the optical frame in the first tracked image; never
    # jumps.
    T_odom_camera: FloatArray | None = None
    # (6, 6) of T_map_camera in the camera frame, rotation first (rad^2, m^2). It is large in a map
    # other than the main map.
    covariance: FloatArray | None = None
    # (6, 6) part whose errors are independent between images.
    image_covariance: FloatArray | None = None
    # Number of matched map points. For the first image of a map, it is the number of features, as
    # is `num_inliers`.
    num_tracked: int = 0
    num_inliers: int = 0  # number of matched map points that fit the pose
    is_keyframe: bool = False
    is_predicted: bool = False  # the image repeats the last one, so that its pose was not measured
    # Duration (ms) of 'track' and, after `learn`, of 'map'. Empty for a lost image, and for the
    # first image of a map.
    stage_ms: dict[str, float] = field(default_factory=dict)
    # A second motion that explains part of the image; None if there is none.
    competing: CompetingMotion | None = None
    note: str = ''  # message for the status; '' if there is none
    # Input of `RgbdSlam.learn`; None: there is nothing to learn.
    to_learn: TrackerOutput | None = None
