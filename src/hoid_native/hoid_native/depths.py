"""Depths where they can be believed: of what boxes show, and away from edges."""

from __future__ import annotations

from ctypes import c_double, c_int32, c_void_p
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoid_native.arguments import address, contiguous
from hoid_native.library import declare

_sample_depths = declare(
    'hoid_sample_depths', c_void_p, *[c_int32] * 3, c_void_p, c_int32, c_void_p
)
_depths_off_edges = declare(
    'hoid_depths_off_edges',
    c_void_p,
    *[c_int32] * 3,
    *[c_void_p] * 2,
    c_int32,
    c_double,
    c_void_p,
)
_torso_depths = declare('hoid_torso_depths', c_void_p, *[c_int32] * 3, *[c_void_p] * 3)


def sample_depths_m(
    depth_m: NDArray[np.float32], boxes_xyxy_px: NDArray[Any], side_px: int
) -> NDArray[np.float64]:
    """Return the (N,) median readings of squares at the centres of boxes; NaN without any.

    Args:
        depth_m: (H, W), not empty; 0 or NaN = no reading.
        boxes_xyxy_px: (N, 4), finite.
        side_px: side of a square; beyond the image it sees the image's edge.

    """
    (height, width), n = depth_m.shape, len(boxes_xyxy_px)
    depth = contiguous(depth_m, np.float32)
    boxes = contiguous(boxes_xyxy_px, np.float64, n, 4)
    out = np.empty(n)
    _sample_depths(address(depth), width, height, n, address(boxes), side_px, address(out))
    return out


def depths_off_edges_m(
    depth_m: NDArray[np.float32], pixels_xy: NDArray[np.int32], radius_px: int, step: float
) -> NDArray[np.float32]:
    """Return the (N,) readings at pixels; 0 where there is none, or where an edge is near.

    Beside an edge a depth camera may read the surface on the other side of it.

    Args:
        depth_m: (H, W); 0 or NaN = no reading.
        pixels_xy: (N, 2) x, y.
        radius_px: half the side of the square around a pixel in which no edge may be; 0: any may.
        step: share of the reading by which others in the square differ where there is one.

    Raises:
        ValueError: A pixel is not in the image.

    """
    height, width = depth_m.shape
    n = len(pixels_xy)
    x, y = np.ascontiguousarray(contiguous(pixels_xy, np.int32, n, 2).T)
    if n and (min(x.min(), y.min()) < 0 or x.max() >= width or y.max() >= height):
        raise ValueError(f'pixels must be inside the image of {width} x {height} px')
    depth = contiguous(depth_m, np.float32)
    out = np.empty(n, np.float32)
    _depths_off_edges(
        address(depth), width, height, n, address(x), address(y), radius_px, step, address(out)
    )
    return out


def torso_depths_m(
    depth_m: NDArray[np.float32], boxes_xyxy_px: NDArray[Any], known_m: NDArray[Any]
) -> NDArray[np.float64]:
    """Return the (N,) depths of the layers that fill the middles of people's boxes; NaN: none.

    The nearest layer of about a torso's thickness that is not much smaller than the largest one is
    the person; readings near the known depth are looked at alone unless they are few.

    Args:
        depth_m: (H, W); 0 or NaN = no reading.
        boxes_xyxy_px: (N, 4), finite, in pixels of this image.
        known_m: (N,) depths of the same people a moment ago; NaN = unknown.

    """
    (height, width), n = depth_m.shape, len(boxes_xyxy_px)
    depth = contiguous(depth_m, np.float32)
    boxes, known = contiguous(boxes_xyxy_px, np.float64, n, 4), contiguous(known_m, np.float64, n)
    out = np.empty(n)
    _torso_depths(address(depth), width, height, n, address(boxes), address(known), address(out))
    return out
