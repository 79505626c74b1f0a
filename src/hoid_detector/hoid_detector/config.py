"""Parameters of the detector, with their defaults."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param
from hoid_common.inputs.input_config import NodeConfig
from hoid_detector.model.finished_boxes import CLASS_IDS
from hoid_detector.model.layouts import LAYOUTS
from hoid_detector.model.letterbox import VALUE_RANGES
from hoid_detector.model.probe import AUTO

_LAYOUTS = tuple(dict.fromkeys(layout.name for layout in LAYOUTS))


@dataclass(frozen=True)
class DetectorConfig(Config):
    """Parameters of detection; `auto`: the value follows from the model (`model/layouts.py`)."""

    model: str = param(
        '',
        'ONNX model of the detector: the path of a file or a known name such as yolox_nano. If it '
        'is empty, a model is searched for: that of the environment variable HOID_MODEL, a known '
        'one in a folder such as ~/.cache/hoid, or yolox_nano, which is downloaded.',
    )
    rate_hz: float = param(
        15.0,  # decision 056
        'Largest number of images in which objects are detected per second of their stamps (Hz); '
        '0 means every image. Boxes are predicted in between. Lower it to save time; set it to 0 '
        'where people come into view fast and close.',
        limits=(0.0, 1000.0),
    )
    # Default of YOLOv5's detect.py.
    score_threshold: float = param(
        0.25,
        'Lowest score of a reported box, from 0 to 1. Lower it when people are missed; raise it '
        'when people are detected where nobody is.',
        limits=(0.0, 1.0),
        read_only=False,
    )
    expected_score_threshold: float = param(
        0.0,  # decision 052
        'Lowest score, from 0 to 1, of a box that is reported because the object map has an '
        'object of its class there; 0: no such box. Set it to 0.05 when known objects are '
        'missed, and set object_map.prior_score of hoid_scene to the value of score_threshold.',
        limits=(0.0, 1.0),
        expert=True,
    )
    # Default of YOLOv5's detect.py.
    nms_iou: float = param(
        0.45,
        'Overlap of two boxes of one class (intersection over union, from 0 to 1) above which '
        'the box with the lower score is removed. Raise it when one of two people side by side is '
        'lost; lower it when a person gets two boxes.',
        limits=(0.0, 1.0),
        read_only=False,
        expert=True,
    )
    classes: tuple[str, ...] = param(
        (),
        'Names of the classes that are reported; empty: all. Set it when other classes are '
        'detected by mistake, and keep person in the list.',
        read_only=False,
    )
    providers: tuple[str, ...] = param(
        (),
        'Execution providers of onnxruntime in order of preference; empty: the first of tensorrt, '
        'cuda, openvino and cpu that is installed. Set it to cpu to keep the GPU free.',
    )
    # Measured with YOLOX-nano: a second thread saves 0.4 of 8.4 ms per image, but uses 3 ms of
    # another core.
    threads: int = param(
        1,
        'Number of CPU threads of the network; 0 means one per core. Raise it for a large model '
        'on a computer with free cores.',
        limits=(0, 256),
    )
    # The size that most YOLO models are trained with.
    input_size_px: int = param(
        640,
        'Longer side of the network input (pixels), for models that accept any size. Lower it to '
        'save processor time, raise it to detect smaller objects.',
        limits=(32, 4096),
        expert=True,
    )
    class_names_file: str = param(
        '',
        'Path of a text file with one class name per line. Set it for a model that contains no '
        'class names, unless it has the 80 classes of COCO.',
        expert=True,
    )
    person_names: tuple[str, ...] = param(
        ('person', 'persons', 'people', 'human', 'humans', 'pedestrian', 'pedestrians'),
        'Names of classes of people, in any case; all are reported as person. A model without '
        'any of these names is refused, unless the list is empty.',
        expert=True,
    )
    camera_roll_deg: float = param(
        0.0,
        'Angle by which the camera is mounted rolled, clockwise as seen from behind (degrees). '
        'Set it when the images are sideways or upside down: they are turned by the nearest '
        'quarter turn. With 0, the angle follows from base_frame if that is set; with 360, images '
        'are never turned.',
        limits=(-360.0, 360.0),
        read_only=False,
    )
    class_ids: str = param(
        AUTO,
        'Meaning of the class ids in the output of a model whose boxes are finished (after '
        'non-maximum suppression): from_0 and from_1 are positions in the list of class names, '
        'counted from 0 or 1; coco_91 are the ids of the COCO data set. Set it when boxes have '
        'wrong class names.',
        choices=(AUTO, *CLASS_IDS),
        expert=True,
    )
    layout: str = param(
        AUTO,
        'Layout of the network output. Set it when it is not recognized: yolov5 is also that of '
        'YOLOv6 and YOLOv7, yolov8 that of YOLOv9 and YOLO11, yolox_raw has boxes in units of '
        'grid cells, rtdetr is the export by Ultralytics, detr that by Transformers. For finished '
        'boxes (after non-maximum suppression), choose end_to_end or the name that lists the '
        'columns: batch is the number of the image in the batch, and yxyx has y before x.',
        choices=(AUTO, *_LAYOUTS),
        expert=True,
    )
    color_order: str = param(
        AUTO,
        'Order of the color channels in the network input. Set it when a model detects little.',
        choices=(AUTO, 'rgb', 'bgr'),
        expert=True,
    )
    value_range: str = param(
        AUTO,
        'Range of the values in the network input: 0 to 1 (unit), 0 to 255 (byte), or '
        'standardized by mean and deviation of ImageNet (imagenet). Set it when a model detects '
        'little or nothing.',
        choices=(AUTO, *VALUE_RANGES),
        expert=True,
    )
    letterbox: str = param(
        AUTO,
        'Placement of the image in the network input: centered or at the top left with padding, '
        'or stretched to the whole input. Set it when the boxes of a model are displaced.',
        choices=(AUTO, 'centered', 'top_left', 'stretch'),
        expert=True,
    )


@dataclass(frozen=True)
class DetectorNodeConfig(NodeConfig, DetectorConfig):
    """Parameters of the detector node."""

    base_frame: str = param(
        '',
        "Name of the robot's base frame, as frames.base of rgbd_slam. The transform on "
        "/tf_static from it to the camera's optical frame tells how the camera is mounted, so "
        'that images are turned upright. It has no effect with camera_roll_deg.',
    )
