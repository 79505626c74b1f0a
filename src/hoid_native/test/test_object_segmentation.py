"""Segmentation of objects in a depth image, against a reference in OpenCV and NumPy."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_native import segment_objects

HEIGHT, WIDTH = 48, 64
NEIGHBORS, GAP = np.ones((3, 3), np.uint8), np.ones((11, 11), np.uint8)


def plain_segmentation(
    depth_m: NDArray[np.float32],
    areas: NDArray[np.int32],
    depths_m: NDArray[np.float64],
    reaches_m: NDArray[np.float64],
    seen: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    gradient_m = cv2.morphologyEx(depth_m, cv2.MORPH_GRADIENT, NEIGHBORS)
    smooth = (gradient_m < 0.02 + 0.03 * depth_m) & (depth_m > 0)
    num, labels = cv2.connectedComponents(smooth.view(np.uint8), connectivity=4)
    flat = labels.ravel()
    sizes = np.bincount(flat, minlength=num)
    mean_m = np.bincount(flat, weights=depth_m.ravel(), minlength=num) / np.maximum(sizes, 1)
    dynamic = np.zeros(depth_m.shape, np.bool_)
    rows = zip(areas.tolist(), depths_m.tolist(), reaches_m.tolist(), seen, strict=True)
    for (x1, y1, x2, y2), object_m, reach_m, there in rows:
        area = slice(y1, y2), slice(x1, x2)
        pixels: NDArray[np.bool_] = np.ones((y2 - y1, x2 - x1), np.bool_)
        if not math.isnan(object_m):
            inside = np.bincount(labels[area].ravel(), minlength=num)
            own = (inside >= 0.6 * sizes) & (np.abs(mean_m - object_m) < reach_m)
            own[0] = False
            wide = beyond(y1, y2), beyond(x1, x2)
            dynamic[wide] |= own[labels[wide]]
            pixels = own[labels[area]]
            if there and sizes[own].sum() < 0.25 * pixels.size:
                pixels |= np.abs(depth_m[area] - np.float32(object_m)) < reach_m
            beside = np.asarray(cv2.dilate(pixels.view(np.uint8), GAP))
            pixels |= (beside > 0) & (depth_m[area] <= 0)
        dynamic[area] |= pixels
    return dynamic


def beyond(first: int, last: int) -> slice:
    """Return the range of columns or rows of an area, extended by a tenth at either end."""
    more = (last - first + 5) // 10
    return slice(max(first - more, 0), last + more)


def scene(rng: np.random.Generator) -> NDArray[np.float32]:
    """Return the depth of blocks in front of a slanted wall, with noise, holes, thin bridges."""
    depth_m = np.tile(np.linspace(2, 4, WIDTH, dtype=np.float32), (HEIGHT, 1))
    for _ in range(8):
        x, y, width, height = rng.integers(0, (WIDTH, HEIGHT, 30, 30))
        depth_m[y : y + height, x : x + width] = rng.uniform(0.5, 3)
    depth_m += rng.normal(0, 0.01, depth_m.shape).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.02] = 0
    x, y = rng.integers(0, (WIDTH, HEIGHT))
    depth_m[y : y + 9, x : x + 13] = 0
    return depth_m


def objects(rng: np.random.Generator, depth_m: NDArray[np.float32], num: int) -> list[Any]:
    first = rng.integers(0, (WIDTH - 1, HEIGHT - 1), (num, 2))
    last = np.minimum(first + rng.integers(1, 40, (num, 2)), (WIDTH, HEIGHT))
    middle = (first + last) // 2
    depths_m = depth_m[middle[:, 1], middle[:, 0]].astype(np.float64)
    depths_m[depths_m == 0] = np.nan
    return [
        np.concatenate([first, last], 1).astype(np.int32),
        depths_m,
        rng.choice([0.25, 0.45], num),
        rng.random(num) < 0.7,
    ]


@pytest.mark.parametrize('num', [0, 1, 3, 30])
def test_objects_are_segmented_like_the_reference(num: int) -> None:
    for seed in range(50):
        rng = np.random.default_rng(seed)
        depth_m = scene(rng)
        given = objects(rng, depth_m, num)
        np.testing.assert_array_equal(
            segment_objects(depth_m, *given), plain_segmentation(depth_m, *given)
        )


def test_a_winding_region_is_one() -> None:
    """The region winds, so that its parts are only connected in the last rows."""
    depth_m = np.zeros((9, 11), np.float32)
    depth_m[:, :3] = depth_m[:, 4:7] = depth_m[:, 8:] = depth_m[6:] = 2.0
    areas = np.array([[0, 0, 11, 9]], np.int32)
    given = areas, np.array([2.0]), np.array([0.2]), np.array([True])
    dynamic = segment_objects(depth_m, *given)
    np.testing.assert_array_equal(dynamic, plain_segmentation(depth_m, *given))
    assert dynamic[0, 1]
    assert dynamic[0, 5]


def test_an_empty_area_marks_nothing() -> None:
    depth_m = np.ones((HEIGHT, WIDTH), np.float32)
    area = np.array([[WIDTH, 3, WIDTH, 9]], np.int32)
    for object_m in (1.0, math.nan):
        given = np.array([object_m]), np.array([0.5]), np.array([True])
        assert not segment_objects(depth_m, area, *given).any()
