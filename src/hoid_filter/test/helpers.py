"""Small scenes with known answers."""

from __future__ import annotations

import numpy as np

from hoid_common.values import BoolArray, Detections, Float32Array, IntArray
from hoid_filter.strategy import FilterInput

HEIGHT, WIDTH = 120, 160
BoxTuple = tuple[float, float, float, float]


def detections(*rows: tuple[str, BoxTuple], stamp_ns: int = 0, score: float = 0.9) -> Detections:
    boxes = np.array([row[1] for row in rows], np.float32).reshape(-1, 4)
    names = tuple(row[0] for row in rows)
    return Detections(stamp_ns, boxes, names, np.full(len(rows), score, np.float32))


def view(
    found: Detections | None,
    depth_m: Float32Array | None = None,
    corners_xy_px: tuple[tuple[int, int], ...] | None = None,
    stamp_ns: int | None = None,
) -> FilterInput:
    """Return the input of a strategy, by default with the stamp of the detections.

    By default every pixel is a corner.
    """
    if stamp_ns is None:
        stamp_ns = 0 if found is None else found.stamp_ns
    pixels = (
        np.arange(HEIGHT * WIDTH)
        if corners_xy_px is None
        else np.array([y * WIDTH + x for x, y in corners_xy_px], np.int64)
    )
    return FilterInput(
        stamp_ns=stamp_ns,
        detections=found,
        depth_m=np.full((HEIGHT, WIDTH), 2.0, np.float32) if depth_m is None else depth_m,
        corner_pixels=pixels,
    )


def picture_of(kept: IntArray | None) -> BoolArray:
    """Return the (HEIGHT, WIDTH) mask of kept pixels, where every pixel is a corner."""
    assert kept is not None
    picture = np.zeros(HEIGHT * WIDTH, np.bool_)
    picture[kept] = True
    return picture.reshape(HEIGHT, WIDTH)
