"""Damaged and hostile ONNX models, written without the onnx package."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_benchmarks.faults.damage import Rng, damaged
from hoid_common.errors import HoidError
from hoid_common.values import FloatArray
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


def damaged_model(place: Path, rng: Rng | None) -> Callable[[], int]:
    """Return a function that loads and runs the synthetic detector with damaged bytes."""
    data = find_model(SYNTHETIC).read_bytes()
    return _detection_work(place, data if rng is None else damaged(data, rng))


def hostile_model(place: Path, rng: Rng | None) -> Callable[[], int]:
    """Return a function that loads and runs a model with abnormal shapes, values or names."""
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


def _detection_work(place: Path, data: bytes) -> Callable[[], int]:
    path = place / 'model.onnx'
    path.write_bytes(data)

    noise = np.random.default_rng(0).integers(0, 256, (*_IMAGE_PX, 3), np.uint8)

    def run() -> int:
        try:
            found = OnnxDetector(path, DetectorConfig()).detect(noise, 0)
        except HoidError as error:
            sys.stderr.write(f'hoid run: {error}\n')
            return 1
        height_px, width_px = _IMAGE_PX
        boxes = found.boxes_xyxy_px
        if not (np.isfinite(boxes).all() and np.isfinite(found.scores).all()):
            raise AssertionError('boxes or scores that are not finite')
        if len(boxes) and (boxes.min() < 0 or (boxes > [width_px, height_px] * 2).any()):
            raise AssertionError('boxes outside the image')
        return 0

    return run


class ConstantModel(NamedTuple):
    """An ONNX model whose output is a constant for every image."""

    image: Sequence[int] = (1, 3, 96, 128)  # declared shape of the input
    shape: Sequence[int] = (1, 84, 252)  # of the stored constant
    value: float = 0.5
    declared_shape: Sequence[int] | None = None  # of the constant; None: the true one
    operator: str = 'Identity'
    domain: str = ''
    output: str = 'output0'
    names: str = ''

    def data(self) -> bytes:
        """Return the bytes of the file, a serialized ModelProto."""
        numbers: FloatArray = np.full(self.shape, self.value)
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
