"""Parameters of the filter node: the filter's parameters, and how messages are combined."""

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
        0.5,  # covers a detector that is late by up to 500 ms (decision 031)
        'Longest time that the final verdict on an image waits for its detections, and features '
        'for the first message of the detector (s). Raise it, with prediction_limit_s, for a '
        'detector that takes longer.',
        minimum=0.0,
        maximum=10.0,
        read_only=False,
        expert=True,
    )
    as_vision_msgs: bool = param(
        default=False,
        description='Whether to subscribe to vision_msgs/Detection2DArray on the topic '
        'detections_2d instead of hoid_msgs/DetectionArray on detections. Set it to true for '
        'another detector; its class_id must be the class name.',
        expert=True,
    )
    timeout_s: float = param(
        2.0,  # chosen: four times the longest delay of a detector in decision 031
        'The detector counts as lost when images have arrived for longer than this time without a '
        'message from it (s). Set it to more than the time that the detector needs for an image.',
        minimum=0.1,
        maximum=3600.0,
        read_only=False,
        expert=True,
    )
    on_loss: str = param(
        UNFILTERED,
        'What to do when the detector is lost: unfiltered keeps publishing features, also those '
        'on people, stop publishes nothing until it answers. Choose stop where a map with people '
        'in it is worse than no odometry.',
        choices=(UNFILTERED, STOP),
        read_only=False,
    )


@dataclass(frozen=True)
class FilterNodeConfig(NodeConfig, FilterConfig):
    """Parameters of the filter node."""

    sync_slop_s: float = param(
        0.02,  # chosen: less than the 33 ms between two images of a camera
        'Largest difference between the stamps of a color image and its depth image (s). Raise it '
        'when /diagnostics counts dropped color and depth images; images that were not taken '
        'together may then be paired.',
        minimum=0.0,
        maximum=1.0,
    )
    detections: DetectionInputConfig = section(DetectionInputConfig)
