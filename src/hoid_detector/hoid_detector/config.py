"""Parameters of the detector: the only place of their defaults."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param
from hoid_common.inputs.input_config import NodeConfig

AUTO = 'auto'


@dataclass(frozen=True)
class DetectorConfig(Config):
    """How images become boxes.

    What is `auto` follows from the model file (see `layouts`); another value overrides that.
    """

    model: str = param(
        '',
        'Detector model, an ONNX file or a known name such as yolox_nano; empty looks in the '
        'usual places. Set it to use a model of your own or a more accurate one.',
    )
    score_threshold: float = param(
        0.25,
        'Lowest score of a box that is reported, a share. Lower it when people are missed, raise '
        'it when people are seen where nobody is.',
        minimum=0.0,
        maximum=1.0,
        read_only=False,
    )
    nms_iou: float = param(
        0.45,
        'Overlap above which the weaker of two boxes of one class goes, as a share (intersection '
        'over union). Raise it when one of two people side by side is lost.',
        minimum=0.0,
        maximum=1.0,
        read_only=False,
    )
    classes: tuple[str, ...] = param(
        (),
        'Names of the classes to report; an empty list reports all. Name some when others are '
        'seen in error, but keep person.',
        read_only=False,
    )
    max_detections: int = param(
        100, 'Largest number of boxes reported of one image; the weakest are left out.',
        minimum=1, maximum=1000, read_only=False, expert=True,
    )  # fmt: skip
    providers: tuple[str, ...] = param(
        (),
        'Execution providers in order of preference (tensorrt, cuda, openvino, cpu); an empty '
        'list takes the first of them that is installed. Set it to keep the GPU free.',
    )
    # One: a second thread gains 0.4 ms of 8.4 with YOLOX-nano and costs 3 ms of another core.
    threads: int = param(
        1,
        'Number of CPU threads of the network; 0 takes one per core. Raise it for a large model '
        'on a computer with cores to spare.',
        minimum=0,
        maximum=256,
    )
    input_size_px: int = param(
        640, 'Longer side of the network input, for models that leave it open (pixels).',
        minimum=32, maximum=4096, expert=True,
    )  # fmt: skip
    class_names_file: str = param(
        '',
        'Text file with one class name a line; empty takes the names in the model. Set it for a '
        'model that brings no names.',
    )
    layout: str = param(
        AUTO,
        'Layout of the network output.',
        choices=(AUTO, 'yolov8', 'yolov5', 'yolox_raw', 'yolox', 'rtdetr', 'end_to_end', 'detr'),
        expert=True,
    )
    color_order: str = param(
        AUTO, 'Order of the colour channels of the network input.',
        choices=(AUTO, 'rgb', 'bgr'), expert=True,
    )  # fmt: skip
    value_range: str = param(
        AUTO, 'Range of the network input: 0 to 1 (unit), or 0 to 255 (byte).',
        choices=(AUTO, 'unit', 'byte'), expert=True,
    )  # fmt: skip
    letterbox: str = param(
        AUTO, 'Where the image lies in the network input, or whether it is stretched over it.',
        choices=(AUTO, 'centered', 'top_left', 'stretch'), expert=True,
    )  # fmt: skip
    box_units: str = param(
        AUTO, 'Unit of the boxes of the network: pixels of its input, or fractions of it.',
        choices=(AUTO, 'pixel', 'normalized'), expert=True,
    )  # fmt: skip


@dataclass(frozen=True)
class DetectorNodeConfig(NodeConfig, DetectorConfig):
    """Parameters of the node."""

    niceness: int = param(
        10,
        'Number by which the process is nicer to others than usual, as of the command nice: poses '
        'do not wait for it. Lower it when it answers too seldom on a busy machine.',
        minimum=0,
        maximum=19,
    )
