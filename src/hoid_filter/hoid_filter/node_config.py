"""Parameters of the filter node: those of the filter, and how messages are combined."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param, section
from hoid_common.inputs.input_config import NodeConfig
from hoid_filter.config import FilterConfig

UNFILTERED, STOP = 'unfiltered', 'stop'


@dataclass(frozen=True)
class DetectionInputConfig(Config):
    """How images and detections are combined."""

    wait_s: float = param(
        0.5,  # covers a detector that is late by up to 500 ms (decision 31)
        'Longest time that the final verdict on an image waits for its own detections (s). '
        "Features are published without waiting, except before the detector's first message.",
        minimum=0.0,
        maximum=10.0,
        read_only=False,
        expert=True,
    )
    as_vision_msgs: bool = param(
        default=False,
        description='Subscribes to the boxes of another detector: vision_msgs/Detection2DArray on '
        'the topic detections_2d, with class names as class_id, instead of detections.',
        expert=True,
    )
    timeout_s: float = param(
        2.0,  # chosen: four times the longest delay of a detector in decision 31
        'The detector counts as lost after this time without detections (s).',
        minimum=0.1,
        maximum=3600.0,
        read_only=False,
        expert=True,
    )
    on_loss: str = param(
        UNFILTERED,
        'What to do when the detector stops responding: unfiltered keeps publishing unfiltered '
        'features, stop publishes nothing. Choose stop where a map with people in it is worse '
        'than no odometry.',
        choices=(UNFILTERED, STOP),
        read_only=False,
    )


@dataclass(frozen=True)
class FilterNodeConfig(NodeConfig, FilterConfig):
    """Parameters of the filter node."""

    sync_slop_s: float = param(
        0.02,  # chosen: less than the 33 ms between two images of a camera
        'Largest stamp difference between a color image and its depth image (s). Raise it when '
        'the camera stamps them apart and the diagnostics count unmatched images.',
        minimum=0.0,
        maximum=1.0,
    )
    detections: DetectionInputConfig = section(DetectionInputConfig)
