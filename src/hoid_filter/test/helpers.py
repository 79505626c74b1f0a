"""Small scenes with known answers."""

from __future__ import annotations

import numpy as np

from hoid_common.values import Detections, Float32Array
from hoid_filter.scene import Scene

HEIGHT, WIDTH = 120, 160
BoxTuple = tuple[float, float, float, float]


def detections(*rows: tuple[str, BoxTuple], stamp_ns: int = 0, score: float = 0.9) -> Detections:
    boxes = np.array([row[1] for row in rows], np.float32).reshape(-1, 4)
    names = tuple(row[0] for row in rows)
    return Detections(stamp_ns, boxes, names, np.full(len(rows), score, np.float32))


def scene(
    found: Detections, depth_m: Float32Array | None = None, corners: Float32Array | None = None
) -> Scene:
    return Scene(
        stamp_ns=found.stamp_ns,
        detections=found,
        detected=True,
        depth_m=np.full((HEIGHT, WIDTH), 2.0, np.float32) if depth_m is None else depth_m,
        corners_uv_px=np.empty((0, 2), np.float32) if corners is None else corners,
        sample_box_px=10,
    )
