"""What tracking says of a frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from hoid_common.values import FloatArray
from rgbd_slam.optimize.pose_consensus import Rival
from rgbd_slam.tracking.tracker import TrackerOutput


class TrackingState(Enum):
    """Whether the pose is known; the values are those of hoid_msgs/SlamStatus."""

    NOT_INITIALIZED = 0
    TRACKING = 1
    LOST = 2


@dataclass(frozen=True, eq=False)
class TrackingResult:
    """What one frame gave."""

    stamp_ns: int
    state: TrackingState
    T_map_camera: FloatArray | None = None  # (4, 4); jumps when the map is corrected
    T_odom_camera: FloatArray | None = None  # (4, 4); never jumps
    covariance: FloatArray | None = None  # (6, 6) of a small motion in the camera's frame,
    # rotation first [rad^2, m^2]; large in a map started after a loss, unless it is the main one
    image_covariance: FloatArray | None = None  # (6, 6) of it, what images in a row do not share
    num_tracked: int = 0  # map points matched
    num_inliers: int = 0  # of them, those that fit the pose
    is_keyframe: bool = False
    stage_ms: dict[str, float] = field(default_factory=dict)  # 'track', 'map'; thread CPU time
    rival: Rival | None = None  # another motion that explains the image
    note: str = ''  # what else is to be said of it
    to_learn: TrackerOutput | None = None  # what is still to be learned from it
