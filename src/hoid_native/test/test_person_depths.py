"""The depth of people in boxes, on known answers and against a reference in NumPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_native import person_depths_m

Box = tuple[float, float, float, float]
WHOLE: Box = (0.0, 0.0, 40.0, 40.0)
HEIGHT, WIDTH = 60, 80


def person_m(depth_m: NDArray[np.float32], box: Box, known_m: float = math.nan) -> float:
    return float(person_depths_m(depth_m, np.array([box]), np.array([known_m]))[0])


def plain_person_m(depth_m: NDArray[np.float32], box: list[float], known_m: float) -> float:
    x1, y1, x2, y2 = box
    first = np.floor([y1 + 0.1 * (y2 - y1), x1 + 0.2 * (x2 - x1)]).astype(int)
    last = np.ceil([y1 + 0.9 * (y2 - y1), x1 + 0.8 * (x2 - x1)]).astype(int)
    (top, left), (bottom, right) = np.maximum(first, 0), np.maximum(last, 0)
    readings = depth_m[top:bottom, left:right].ravel()
    readings = readings[(readings > 0) & (readings < 10.0)]
    near = readings[np.abs(readings - np.float32(known_m)) < 0.5]
    readings = near if len(near) > 0.3 * len(readings) else readings
    if len(readings) == 0:
        return math.nan
    bins = (readings / np.float32(0.1)).astype(np.int64)
    count = np.append(np.bincount(bins, minlength=4), [0] * 3)
    layers = np.lib.stride_tricks.sliding_window_view(count, 4).sum(axis=1)
    large = int(np.argmax(layers >= 0.6 * layers.max()))
    first_bin = large + int(np.argmax(layers[large : large + 4]))
    inside = readings[(bins >= first_bin) & (bins < first_bin + 4)]
    return float(np.sort(inside)[len(inside) // 2])


@pytest.mark.parametrize('depth_mm', [1299, 1300, 1301, 2100, 4700])
def test_a_flat_person_has_the_depth_of_every_reading(depth_mm: int) -> None:
    """The depth is right even if rounding puts a reading on the border of two bins."""
    depth_m = np.full((40, 40), depth_mm / 1000, np.float32)
    assert person_m(depth_m, WHOLE) == pytest.approx(depth_mm / 1000)


def test_a_partly_hidden_person_keeps_the_known_depth() -> None:
    depth_m = np.full((40, 40), 3.0, np.float32)
    depth_m[16:] = 1.5  # a table in front
    assert person_m(depth_m, WHOLE, 3.1) == pytest.approx(3.0)


def test_a_known_depth_of_the_background_is_dropped() -> None:
    """The known depth is that of the wall: only an arm was visible in the earlier image."""
    depth_m = np.full((40, 40), 3.6, np.float32)
    depth_m[:, 6:34] = 2.6
    assert person_m(depth_m, WHOLE, 3.9) == pytest.approx(2.6)


@pytest.mark.parametrize('seed', range(50))
def test_depths_equal_the_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth_m = np.kron(rng.uniform(0.05, 11, (6, 8)), np.ones((10, 10))).astype(np.float32)
    depth_m += rng.normal(0, 0.1, depth_m.shape).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.1] = 0.0
    depth_m[rng.random(depth_m.shape) < 0.1] = np.nan
    first = rng.uniform(-10, (WIDTH, HEIGHT), (40, 2))
    boxes = np.concatenate([first, first + rng.uniform(0, 50, (40, 2))], 1)
    known_m = rng.uniform(0, 10, 40)
    known_m[::3] = np.nan
    expected = [plain_person_m(depth_m, *row) for row in zip(boxes.tolist(), known_m, strict=True)]
    np.testing.assert_array_equal(person_depths_m(depth_m, boxes, known_m), expected)


def test_nobody_no_depths() -> None:
    assert person_depths_m(np.ones((4, 4), np.float32), np.empty((0, 4)), np.empty(0)).shape == (
        0,
    )
