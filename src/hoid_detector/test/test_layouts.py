"""Every output layout is recognized, and its boxes are decoded exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_common.errors import ModelError
from hoid_common.values import Detections
from hoid_detector.config import DetectorConfig
from hoid_detector.model.decoders import cells
from hoid_detector.onnx_detector import OnnxDetector

SIZE_WH = (96, 64)  # network input
IMAGE = np.full((128, 192, 3), 60, np.uint8)  # fills the network input at scale 1/2
NAMES = ('person', 'cup', 'box')
METADATA = {'names': str(dict(enumerate(NAMES)))}
STRIDES = (8, 16, 32)
NUM_CELLS = 126
# Two boxes of one object, the same box with another class, and another object; x1 y1 x2 y2 in
# pixels of the network input.
FOUND = (
    ((10.0, 20.0, 30.0, 60.0), 'person', 0.9),
    ((11.0, 20.0, 31.0, 60.0), 'person', 0.8),
    ((10.0, 20.0, 30.0, 60.0), 'cup', 0.7),
    ((50.0, 8.0, 90.0, 24.0), 'box', 0.6),
)
EXPECTED = [
    ((20.0, 40.0, 60.0, 120.0), 'person', 0.9),
    ((20.0, 40.0, 60.0, 120.0), 'cup', 0.7),
    ((100.0, 16.0, 180.0, 48.0), 'box', 0.6),
]
EXPECTED_WITHOUT_NMS = [EXPECTED[0], ((22.0, 40.0, 62.0, 120.0), 'person', 0.8), *EXPECTED[1:]]

Array = NDArray[Any]


def cxcywh(box: tuple[float, ...]) -> Array:
    x1, y1, x2, y2 = box
    return np.array([(x1 + x2) / 2, (y1 + y2) / 2, x2 - x1, y2 - y1])


def anchors(num_anchors: int, *, objectness: bool, per_cell: int = 1) -> Array:
    """Return a (N, C) output with weak boxes in their cells and the boxes of FOUND at any rows."""
    cell, stride = cells(SIZE_WH, STRIDES)
    table = np.full((num_anchors, 4 + objectness + len(NAMES)), 0.01)
    if num_anchors == NUM_CELLS * per_cell:
        table[:, :2] = np.tile(((cell + 0.5) * stride).T, (per_cell, 1))
        table[:, 2:4] = 8
    for row, (box, name, score) in enumerate(FOUND):
        table[17 * row, :4] = cxcywh(box)
        table[17 * row, 4 + objectness + NAMES.index(name)] = score / (0.95 if objectness else 1)
        if objectness:
            table[17 * row, 4] = 0.95
    return table


def yolox_raw() -> Array:
    table = anchors(NUM_CELLS, objectness=True)
    cell, stride = cells(SIZE_WH, STRIDES)
    table[:, :2] = table[:, :2] / stride[:, None] - cell.T
    table[:, 2:4] = np.log(table[:, 2:4] / stride[:, None])
    return table


def yolov6() -> Array:
    table = anchors(NUM_CELLS, objectness=True)
    table[:, 5:] *= table[:, 4:5]
    table[:, 4] = 1
    return table


def rtdetr() -> Array:
    table = anchors(300, objectness=False)
    table[:, :4] /= np.array(SIZE_WH * 2)
    return table


def end_to_end() -> Array:
    table = np.zeros((300, 6))
    for row, (box, name, score) in enumerate(FOUND):
        table[row] = (*box, score, NAMES.index(name))
    return table


def yolov7_end_to_end() -> Array:
    finished = end_to_end()[: len(FOUND)]
    return np.column_stack([np.zeros(len(FOUND)), finished[:, :4], finished[:, 5], finished[:, 4]])


def split() -> dict[str, Array]:
    table = end_to_end()
    return {
        'labels': table[None, :, 5].astype(np.int64),
        'boxes': table[None, :, :4],
        'scores': table[None, :, 4],
    }


def logits() -> dict[str, Array]:
    table = rtdetr()
    return {
        'logits': np.log(table[None, :, 4:] / (1 - table[None, :, 4:])),
        'pred_boxes': table[None, :, :4],
    }


def one(table: Array) -> dict[str, Array]:
    return {'output0': table[None]}


LAYOUTS: dict[str, tuple[str, dict[str, Array]]] = {
    'YOLOv8': ('yolov8', one(anchors(NUM_CELLS, objectness=False).T)),
    'YOLOv8 transposed': ('yolov8', one(anchors(NUM_CELLS, objectness=False))),
    'YOLOv5': ('yolov5', one(anchors(3 * NUM_CELLS, objectness=True, per_cell=3))),
    'YOLOv6': ('yolov5', one(yolov6())),
    'YOLOX raw': ('yolox_raw', one(yolox_raw())),
    'YOLOX decoded': ('yolox', one(anchors(NUM_CELLS, objectness=True))),
    'RT-DETR by Ultralytics': ('rtdetr', one(rtdetr())),
    'YOLOv10': ('end_to_end', one(end_to_end())),
    'YOLOv10 normalized': ('end_to_end', one(end_to_end() / np.array([*SIZE_WH * 2, 1, 1]))),
    'YOLOv7 end to end': ('end_to_end', {'output': yolov7_end_to_end()}),
    'boxes, labels, scores': ('end_to_end', split()),
    'logits and boxes': ('detr', logits()),
}
SUPPRESSED = ('yolov8', 'yolov5', 'yolox', 'yolox_raw')


def as_floats(outputs: dict[str, Array], dtype: str) -> dict[str, Array]:
    return {name: a if a.dtype.kind == 'i' else a.astype(dtype) for name, a in outputs.items()}


def check(found: Detections, expected: list[Any], tolerance_px: float) -> None:
    assert found.class_names == tuple(name for _, name, _ in expected)
    np.testing.assert_allclose(found.boxes_xyxy_px, [b for b, _, _ in expected], atol=tolerance_px)
    np.testing.assert_allclose(found.scores, [s for _, _, s in expected], atol=0.002)


@pytest.mark.parametrize('dtype', ['float32', 'float16'])
@pytest.mark.parametrize('case', LAYOUTS)
def test_a_layout_is_recognized_and_decoded(case: str, dtype: str, make_model: Any) -> None:
    layout, outputs = LAYOUTS[case]
    path = make_model(as_floats(outputs, dtype), dtype=dtype, metadata=METADATA)
    detector = OnnxDetector(path, DetectorConfig())
    found = detector.detect(IMAGE, 7)
    assert detector.layout.name == layout
    assert found.stamp_ns == 7
    expected = EXPECTED if layout in SUPPRESSED else EXPECTED_WITHOUT_NMS
    check(found, expected, 0.001 if dtype == 'float32' else 0.4)


def test_a_network_that_takes_the_image_size_returns_boxes_in_pixels(make_model: Any) -> None:
    outputs = as_floats(split(), 'float32')
    outputs['boxes'] = outputs['boxes'] / np.array(SIZE_WH * 2, np.float32)
    path = make_model(outputs, metadata=METADATA, boxes_times_size='boxes')
    check(OnnxDetector(path, DetectorConfig()).detect(IMAGE, 0), EXPECTED_WITHOUT_NMS, 0.001)


def test_rows_beyond_the_number_of_detections_are_ignored(make_model: Any) -> None:
    parts = split()
    outputs = {
        'num_dets': np.array([[2]], np.int32),
        'det_boxes': parts['boxes'].astype(np.float32),
        'det_scores': parts['scores'].astype(np.float32),
        'det_classes': parts['labels'].astype(np.int32),
    }
    detector = OnnxDetector(make_model(outputs, metadata=METADATA), DetectorConfig())
    check(detector.detect(IMAGE, 0), EXPECTED_WITHOUT_NMS[:2], 0.001)


@pytest.mark.parametrize(
    ('kind', 'preprocessing'),
    [
        ('YOLOv8', 'RGB 0-1, centered'),
        ('YOLOX raw', 'BGR 0-255, top_left'),
        ('YOLOX decoded', 'BGR 0-255, top_left'),
        ('YOLOv6', 'RGB 0-1, centered'),
        ('boxes, labels, scores', 'RGB 0-1, stretch'),
    ],
)
def test_the_layout_determines_the_preprocessing(
    kind: str, preprocessing: str, make_model: Any
) -> None:
    path = make_model(as_floats(LAYOUTS[kind][1], 'float32'), metadata=METADATA)
    assert str(OnnxDetector(path, DetectorConfig()).layout.preprocessing) == preprocessing


def test_parameters_override_the_recognized_layout(make_model: Any) -> None:
    path = make_model(as_floats(LAYOUTS['YOLOX decoded'][1], 'float32'), metadata=METADATA)
    config = DetectorConfig(
        layout='yolov5', color_order='bgr', value_range='byte', letterbox='stretch'
    )
    layout = OnnxDetector(path, config).layout
    assert (layout.name, str(layout.preprocessing)) == ('yolov5', 'BGR 0-255, stretch')
    with pytest.raises(ModelError, match='boxes are outside the image and 0 inside'):
        OnnxDetector(path, DetectorConfig(layout='yolox_raw')).detect(IMAGE, 0)


@pytest.mark.parametrize(
    ('outputs', 'found'),
    [
        ({'output0': np.zeros((1, 39, 126))}, 'output0 float32 1x39x126'),  # masks: 4 + 3 + 32
        ({'o': np.zeros((1, 3, 8, 12, 8))}, 'o float32 1x3x8x12x8'),  # YOLOv7 before decoding
        ({'o': np.zeros((1, 1000))}, 'o float32 1x1000'),  # a classifier
        ({'a': np.zeros((1, 7, 126)), 'b': np.zeros((1, 2, 3))}, 'a float32 1x7x126, b'),
    ],
)
def test_the_error_for_an_unknown_layout_names_the_outputs(
    outputs: dict[str, Array], found: str, make_model: Any
) -> None:
    path = make_model(as_floats(outputs, 'float32'), metadata=METADATA)
    with pytest.raises(ModelError, match='unknown output layout') as error:
        OnnxDetector(path, DetectorConfig())
    assert found in str(error.value)
    assert '96x64' in str(error.value)
    assert '\n' not in str(error.value)
