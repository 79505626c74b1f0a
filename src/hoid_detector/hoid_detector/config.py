"""Parameters of the detector, with their defaults."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param
from hoid_common.inputs.input_config import NodeConfig
from hoid_detector.model.layouts import AUTO, LAYOUTS

_LAYOUTS = tuple(dict.fromkeys(layout.name for layout in LAYOUTS))


@dataclass(frozen=True)
class DetectorConfig(Config):
    """Parameters of detection.

    The value `auto` follows from the model file (see `model/layouts.py`).
    """

    model: str = param(
        '',
        'ONNX model of the detector, as a file or a known name such as yolox_nano. With an empty '
        'string, HOID_MODEL, the folder of shared models and the cache are searched, and '
        'YOLOX-nano is downloaded if needed. Set it to use another model.',
    )
    # As in YOLOv5's detect.py.
    score_threshold: float = param(
        0.25,
        'Lowest score of a reported box, as a share. Lower it when people are missed; raise it '
        'when people are detected by mistake.',
        minimum=0.0,
        maximum=1.0,
        read_only=False,
    )
    # As in YOLOv5's detect.py.
    nms_iou: float = param(
        0.45,
        'Overlap (intersection over union) above which the weaker of two boxes of one class is '
        'removed, as a share. Raise it when one of two people side by side is lost.',
        minimum=0.0,
        maximum=1.0,
        read_only=False,
    )
    classes: tuple[str, ...] = param(
        (),
        'Names of the reported classes; an empty list reports all. Set it when objects of other '
        'classes are detected by mistake, and keep person in it.',
        read_only=False,
    )
    max_detections: int = param(
        100,
        'Largest number of boxes reported for one image. The boxes with the lowest scores are '
        'left out.',
        minimum=1,
        maximum=1000,
        read_only=False,
        expert=True,
    )
    providers: tuple[str, ...] = param(
        (),
        'Execution providers of onnxruntime in order of preference (tensorrt, cuda, openvino, '
        'cpu). With an empty list, the first installed one is used. Set it to keep the GPU free.',
    )
    # Measured: a second thread saves 0.4 ms of 8.4 with YOLOX-nano and costs 3 ms of another core.
    threads: int = param(
        1,
        'Number of CPU threads of the network; 0 means one per core. Raise it for a large model '
        'on a computer with free cores.',
        minimum=0,
        maximum=256,
    )
    # The size that most YOLO models are trained with.
    input_size_px: int = param(
        640,
        'Longer side of the network input, for models that accept any size (pixels).',
        minimum=32,
        maximum=4096,
        expert=True,
    )
    class_names_file: str = param(
        '',
        'Text file with one class name per line. With an empty string, the names in the model '
        'are used. Set it for a model that contains no names.',
    )
    layout: str = param(
        AUTO,
        'Layout of the network output. Set it when the layout of a model is not recognized.',
        choices=(AUTO, *_LAYOUTS),
        expert=True,
    )
    color_order: str = param(
        AUTO,
        'Order of the color channels in the network input.',
        choices=(AUTO, 'rgb', 'bgr'),
        expert=True,
    )
    value_range: str = param(
        AUTO,
        'Range of the values in the network input: 0 to 1 (unit), or 0 to 255 (byte).',
        choices=(AUTO, 'unit', 'byte'),
        expert=True,
    )
    letterbox: str = param(
        AUTO,
        'Placement of the image in the network input: centered or at the top left with padding, '
        'or stretched to the whole input.',
        choices=(AUTO, 'centered', 'top_left', 'stretch'),
        expert=True,
    )
    box_units: str = param(
        AUTO,
        'Unit of the boxes in the network output: pixels or fractions of the network input.',
        choices=(AUTO, 'pixel', 'normalized'),
        expert=True,
    )


@dataclass(frozen=True)
class DetectorNodeConfig(NodeConfig, DetectorConfig):
    """Parameters of the detector node."""

    # Decision 016: measured with 10, the scene mapper in the idle class.
    niceness: int = param(
        10,
        'Number that is added to the niceness of the process, as by the command nice, so that '
        'tracking has priority. Lower it when detections come too rarely on a busy computer.',
        minimum=0,
        maximum=19,
    )
