"""The result of tracking one frame."""

from __future__ import annotations

from dataclasses import dataclass, field

from hoid_common.slam_status import SlamState
from hoid_common.values import FloatArray
from rgbd_slam.optimize.pose_consensus import CompetingMotion
from rgbd_slam.tracking.tracker import TrackerOutput


@dataclass(frozen=True, eq=False)
class TrackingResult:
    """The pose of one frame, its covariances and the tracking statistics.

    Poses and covariances are None before a map is started, and if the camera is lost and no motion
    source has a pose.
    """

    stamp_ns: int
    state: SlamState
    # (4, 4) in the core's map frame; it jumps when the map is corrected.
    T_map_camera: FloatArray | None = None
    # (4, 4) in the core's odometry frame, the optical frame of the camera in the first tracked
    # image; it never jumps.
    T_odom_camera: FloatArray | None = None
    # (6, 6) of T_map_camera in the camera frame, rotation first [rad^2, m^2]. It is large in a map
    # that was started after a loss and is not the main one.
    covariance: FloatArray | None = None
    image_covariance: FloatArray | None = None  # (6, 6) part whose errors differ between images
    # Number of matched map points. For the first image of a map, this number and `num_inliers` are
    # the number of features.
    num_tracked: int = 0
    num_inliers: int = 0  # number of matched map points that fit the pose
    is_keyframe: bool = False
    is_predicted: bool = False  # the image is a copy of the last one; its pose was not measured
    # Duration of 'track' and, once `learn` has used the image, of 'map'. It is empty for a lost
    # image, and for the first image of a map.
    stage_ms: dict[str, float] = field(default_factory=dict)
    # A second motion that explains part of the image; None if there is none.
    competing: CompetingMotion | None = None
    note: str = ''  # message for the status; '' if there is none
    to_learn: TrackerOutput | None = None  # for `RgbdSlam.learn`; None: nothing is to be learned
