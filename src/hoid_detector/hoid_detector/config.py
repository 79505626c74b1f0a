"""Parameters of the detector: the only place of their defaults."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param

AUTO = 'auto'


@dataclass(frozen=True)
class DetectorConfig(Config):
    """How images become boxes.

    What is `auto` follows from the model file (see `layouts`); another value overrides that.
    """

    score_threshold: float = param(
        0.25, 'Lowest score of a reported box', minimum=0.0, maximum=1.0, read_only=False
    )
    nms_iou: float = param(
        0.45,
        'Overlap (intersection over union) above which the weaker of two boxes of one class goes',
        minimum=0.0,
        maximum=1.0,
        read_only=False,
    )
    classes: tuple[str, ...] = param(
        (), 'Names of the classes to report; empty reports all', read_only=False
    )
    max_detections: int = param(
        100, 'Most boxes reported of one image', minimum=1, maximum=1000, read_only=False
    )
    providers: tuple[str, ...] = param(
        (),
        'Execution providers in order of preference (tensorrt, cuda, openvino, cpu); '
        'empty takes the first of that list which is installed',
    )
    # One: a second thread gains 0.4 ms of 8.4 with YOLOX-nano and costs 3 ms of another core.
    threads: int = param(
        1, 'Threads of the network on the CPU; 0 takes one per core', minimum=0, maximum=256
    )
    input_size_px: int = param(
        640,
        'Longer side of the network input, for models that leave it open',
        minimum=32,
        maximum=4096,
    )
    class_names_file: str = param(
        '', 'Text file with one class name a line; empty takes the names in the model'
    )
    layout: str = param(
        AUTO,
        'Layout of the network output',
        choices=(AUTO, 'yolov8', 'yolov5', 'yolox_raw', 'yolox', 'rtdetr', 'end_to_end', 'detr'),
    )
    color_order: str = param(
        AUTO, 'Order of the colour channels of the network input', choices=(AUTO, 'rgb', 'bgr')
    )
    value_range: str = param(
        AUTO, 'Range of the network input: 0 to 1, or 0 to 255', choices=(AUTO, 'unit', 'byte')
    )
    letterbox: str = param(
        AUTO,
        'Where the image lies in the network input, or whether it is stretched over it',
        choices=(AUTO, 'centered', 'top_left', 'stretch'),
    )
    box_units: str = param(
        AUTO,
        'Boxes of the network: pixels of its input, or fractions of it',
        choices=(AUTO, 'pixel', 'normalized'),
    )
