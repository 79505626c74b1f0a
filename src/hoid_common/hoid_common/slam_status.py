"""How the SLAM node is doing, as a value; the message is hoid_msgs/SlamStatus."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum


class SlamState(Enum):
    """What is known of the pose; the values are those of hoid_msgs/SlamStatus."""

    NOT_INITIALIZED = 0
    TRACKING = 1
    LOST = 2
    PAUSED = 3


class SlamMode(Enum):
    """Whether the map grows; the values are those of hoid_msgs/SlamStatus."""

    MAPPING = 0
    LOCALIZATION = 1


@dataclass(frozen=True)
class SlamStatus:
    """One image's report; counts of frames, loops and recoveries are since the last reset."""

    state: SlamState
    mode: SlamMode = SlamMode.MAPPING
    message: str = ''
    tracked_points: int = 0
    inliers: int = 0
    keyframes: int = 0
    map_points: int = 0
    maps: int = 0
    mapper_queue: int = 0
    loops: int = 0
    merges: int = 0
    relocalizations: int = 0
    frames_processed: int = 0
    frames_dropped: int = 0
    stage_ms: Mapping[str, float] = field(default_factory=dict)
