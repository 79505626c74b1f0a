"""State of the SLAM after one image; hoid_msgs/SlamStatus is the corresponding message."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum


class SlamState(Enum):
    """State of tracking; the values are the constants of hoid_msgs/SlamStatus."""

    NOT_INITIALIZED = 0
    TRACKING = 1
    LOST = 2
    PAUSED = 3


class SlamMode(Enum):
    """Whether the map may change; the values are the constants of hoid_msgs/SlamStatus."""

    MAPPING = 0
    LOCALIZATION = 1


@dataclass(frozen=True)
class SlamStatus:
    """State and counters of the SLAM after one image.

    Frames, loops, merges and relocalizations are counted from the start or the last reset.
    """

    state: SlamState
    mode: SlamMode = SlamMode.MAPPING
    message: str = ''  # reason for the state; empty if there is no particular reason
    tracked_points: int = 0  # map points matched in this image
    inliers: int = 0  # matched points that agree with the pose
    keyframes: int = 0  # number in the main map
    map_points: int = 0  # number in the main map
    maps: int = 0  # number of maps, the main map included
    mapper_queue: int = 0  # keyframes that wait for the mapper
    loops: int = 0  # closed loops
    merges: int = 0  # merged maps
    relocalizations: int = 0  # recoveries from LOST
    frames_processed: int = 0
    frames_dropped: int = 0  # missing images, estimated from gaps between stamps
    stage_ms: Mapping[str, float] = field(default_factory=dict)  # duration by stage
