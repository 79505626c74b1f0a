"""Damaged and hostile ONNX models, written without the onnx package."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_benchmarks.faults.damage import Rng, damaged
from hoid_benchmarks.faults.recordings import SILENT
from hoid_common.errors import HoidError
from hoid_common.values import Detections, FloatArray
from hoid_detector.config import DetectorConfig
from hoid_detector.model.model_path import SYNTHETIC, find_model
from hoid_detector.onnx_detector import OnnxDetector

_FLOAT, _IR_VERSION, _OPSET = 1, 8, 17  # constants of onnx.proto
_IMAGE_PX = (96, 128)
_STRANGE = ('\udcff', '', 'é\u202e\n', 'x' * 100_000, '../../etc/passwd', '%s%n')
_NAMES = (
    '\udcff',
    "{0: 'person', 7: 'cup'}",
    '[' * 5000,
    '{0: {1: 2}}',
    'a' * 100_000,
    "['a'] * 10**9",
)
_SHAPES = ((1, 84, 252), (1, 6), (0,), (), (1, 1, 1, 1, 1, 1), (1, 252, 85), (1, 5, 3), (3, 4, 5))
_HUGE = 1 << 40
_CLASSES = {0: 'person', 1: 'cup', 2: 'chair'}
# Of a table x0 y0 x1 y1 score class, as exporters order them; y before x cannot be told by values.
_COLUMNS = (
    [0, 1, 2, 3, 4, 5], [0, 1, 2, 3, 5, 4], [5, 4, 0, 1, 2, 3], [4, 5, 0, 1, 2, 3],
    [5, 0, 1, 2, 3, 4],
)  # fmt: skip


def damaged_model(place: Path, rng: Rng | None) -> Callable[[], int]:
    """Return a function that runs the synthetic detector, damaged unless `rng` is None."""
    data = find_model(SYNTHETIC).read_bytes()
    return _detection_work(place, data if rng is None else damaged(data, rng))


def hostile_model(place: Path, rng: Rng | None) -> Callable[[], int]:
    """Return a function that runs a model, with one abnormal property unless `rng` is None."""
    model = ConstantModel()
    if rng is not None:
        changes = (
            lambda: model._replace(value=float(rng.choice([np.nan, np.inf, -np.inf, 1e30]))),
            lambda: model._replace(shape=_SHAPES[int(rng.integers(len(_SHAPES)))]),
            lambda: model._replace(declared_shape=(1, _HUGE, _HUGE)),
            lambda: model._replace(declared_shape=(-1, 84)),
            lambda: model._replace(operator='Detect', domain='evil.example'),
            lambda: model._replace(operator='NoSuchOperator'),
            lambda: model._replace(output=str(rng.choice(_STRANGE))),
            lambda: model._replace(names=str(rng.choice(_NAMES))),
            lambda: model._replace(image=((1, 3), (0, 0, 0, 0), (_HUGE,) * 4)[rng.integers(3)]),
            lambda: model._replace(image=(1, 3, -1, -1)),
        )
        model = changes[int(rng.integers(len(changes)))]()
    return _detection_work(place, model.data())


def finished_boxes(place: Path, rng: Rng | None) -> Callable[[], int]:
    """Return a function that runs a model whose answer is a table, one row for each box.

    Exporters order and scale the columns in many ways. The boxes must be found as they are, or
    the model must be refused.
    """
    height_px, width_px = _IMAGE_PX
    corners_px = np.array([[x, y] for y in range(4, 80, 30) for x in range(4, 110, 26)], float)
    size_px = np.array([14.0, 22.0])
    boxes = np.hstack([corners_px, corners_px + size_px])
    random = np.random.default_rng(0) if rng is None else rng
    scores, classes = random.uniform(0.4, 0.99, len(boxes)), random.integers(0, 3, len(boxes))
    table = np.column_stack([boxes, scores, classes])
    if rng is not None:
        if rng.random() < 0.3:  # center and size
            table[:, :4] = np.hstack(
                [(boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]]
            )
        if rng.random() < 0.3:  # shares of the image
            table[:, :4] /= [width_px, height_px] * 2
        table = table[:, _COLUMNS[int(rng.integers(len(_COLUMNS)))]]
        if rng.random() < 0.3:  # the number of the image in front
            table = np.column_stack([np.zeros(len(table)), table])
    model = ConstantModel(shape=(1, *table.shape), table=table, names=str(_CLASSES))
    expected = {_CLASSES[c]: boxes[classes == c] for c in range(len(_CLASSES))}
    return _detection_work(place, model.data(), expected)


def no_people(place: Path, rng: Rng | None) -> Callable[[], int]:
    """Return a function that runs a model that names people in another way, or has no people."""
    names = dict(_CLASSES)
    if rng is not None:
        names[0] = str(rng.choice(['Person', 'PEOPLE', 'pedestrian', 'Mensch', 'worker', '0', '']))
    values = np.full((1, 4 + len(names), 252), 0.5)
    model = ConstantModel(shape=values.shape, names=str(names))
    is_person = names[0].lower() in DetectorConfig().person_names
    return _detection_work(place, model.data(), must_be_refused=not is_person)


def _detection_work(
    place: Path,
    data: bytes,
    expected: Mapping[str, FloatArray] | None = None,
    *,
    must_be_refused: bool = False,
) -> Callable[[], int]:
    """Return a function that runs a model on an image of random pixels, and checks the boxes.

    Args:
        place: Folder for the model.
        data: The model.
        expected: (N, 4) boxes that must be found, by class name; None: any inside the image.
        must_be_refused: Whether any answer of the model is wrong.
    """
    path = place / 'model.onnx'
    path.write_bytes(data)

    noise = np.random.default_rng(0).integers(0, 256, (*_IMAGE_PX, 3), np.uint8)

    def run() -> int:
        try:
            found = OnnxDetector(path, DetectorConfig()).detect(noise, 0)
        except HoidError as error:
            sys.stderr.write(f'hoid run: {error}\n')
            return 1
        if must_be_refused:
            raise AssertionError('a model without people was accepted')
        if expected is not None and not _is_as_expected(found, expected):
            return SILENT
        height_px, width_px = _IMAGE_PX
        boxes = found.boxes_xyxy_px
        if not (np.isfinite(boxes).all() and np.isfinite(found.scores).all()):
            raise AssertionError('boxes or scores that are not finite')
        if len(boxes) and (boxes.min() < 0 or (boxes > [width_px, height_px] * 2).any()):
            raise AssertionError('boxes outside the image')
        return 0

    return run


def _is_as_expected(found: Detections, expected: Mapping[str, FloatArray]) -> bool:
    """Return whether exactly the expected boxes were found, within a pixel."""
    for name, boxes in expected.items():
        is_class = np.array([class_name == name for class_name in found.class_names], bool)
        given = found.boxes_xyxy_px[is_class]
        if len(given) != len(boxes):
            return False
        distance_px = np.abs(given[:, None] - boxes[None]).max(axis=2)
        if len(boxes) and distance_px.min(axis=1).max() > 1:
            return False
    return len(found.class_names) == sum(map(len, expected.values()))


class ConstantModel(NamedTuple):
    """An ONNX model whose output is a constant for every image."""

    image: Sequence[int] = (1, 3, 96, 128)  # declared shape of the input
    shape: Sequence[int] = (1, 84, 252)  # of the stored constant
    value: float = 0.5
    table: FloatArray | None = None  # the constant; None: `value` everywhere
    declared_shape: Sequence[int] | None = None  # of the constant; None: the true one
    operator: str = 'Identity'
    domain: str = ''
    output: str = 'output0'
    names: str = ''

    def data(self) -> bytes:
        """Return the bytes of the file, a serialized ModelProto."""
        numbers: FloatArray = np.full(self.shape, self.value)
        if self.table is not None:
            numbers[:] = self.table
        dims = b''.join(_number(1, d) for d in (self.declared_shape or self.shape))
        constant = dims + _number(2, _FLOAT) + _text(8, 'c')
        constant += _bytes(9, numbers.astype('<f4').tobytes())
        node = _text(1, 'c') + _text(2, self.output) + _text(4, self.operator)
        node += _text(7, self.domain)
        graph = _bytes(1, node) + _text(2, 'g') + _bytes(5, constant)
        graph += _bytes(11, _value('images', self.image))
        graph += _bytes(12, _value(self.output, None))
        opset = _bytes(8, _text(1, '') + _number(2, _OPSET))
        if self.domain:
            opset += _bytes(8, _text(1, self.domain) + _number(2, 1))
        model = _number(1, _IR_VERSION) + _bytes(7, graph) + opset
        return model + _bytes(14, _text(1, 'names') + _text(2, self.names)) * bool(self.names)


def _value(name: str, shape: Sequence[int] | None) -> bytes:
    """Return a ValueInfoProto of floats."""
    tensor = _number(1, _FLOAT)
    if shape is not None:
        tensor += _bytes(2, b''.join(_bytes(1, _number(1, d)) for d in shape))
    return _text(1, name) + _bytes(2, _bytes(1, tensor))


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value % (1 << 64))


def _text(field: int, value: str) -> bytes:
    return _bytes(field, value.encode(errors='surrogateescape'))


def _bytes(field: int, value: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(value)) + value


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])
