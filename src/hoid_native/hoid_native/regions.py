"""What boxes show, cut out of a depth image."""

from __future__ import annotations

from ctypes import c_int32, c_void_p

import numpy as np
from numpy.typing import NDArray

from hoid_native.arguments import address, contiguous
from hoid_native.library import declare

_cover_things = declare('hoid_cover_things', c_void_p, *[c_int32] * 3, *[c_void_p] * 6)


def cover_things(
    depth_m: NDArray[np.float32],
    areas_xyxy_px: NDArray[np.int32],
    depths_m: NDArray[np.float64],
    reaches_m: NDArray[np.float64],
    certainties: NDArray[np.uint8],
    seen: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Return how sure it is, (H, W), that each pixel shows something that moves; 0 = static.

    The image is cut into regions along the jumps of depth. A thing is the regions that lie mostly
    in its area and near its depth, and the gaps without readings beside them. It may reach out of
    its area by a tenth of a side, as a box is not exact; what lies further out has only merged
    with it in depth, as a desk with who leans on it.

    Args:
        depth_m: (H, W); 0 = no reading.
        areas_xyxy_px: (N, 4) whole pixels within the image, the last exclusive.
        depths_m: (N,) of the things; NaN = unknown: then a thing is its whole area.
        reaches_m: (N,) how far things reach before and behind their depth.
        certainties: (N,) how sure it is that they move.
        seen: (N,) things that are there for sure: when a thing's regions are too little of its
            area, it has merged with what it touches, and all pixels near its depth count.

    """
    (height, width), n = depth_m.shape, len(areas_xyxy_px)
    depth = contiguous(depth_m, np.float32)
    areas = contiguous(areas_xyxy_px, np.int32, n, 4)
    things = (
        contiguous(depths_m, np.float64, n),
        contiguous(reaches_m, np.float64, n),
        contiguous(certainties, np.uint8, n),
        contiguous(seen, np.bool_, n),
    )
    out = np.empty((height, width), np.uint8)
    _cover_things(
        address(depth), width, height, n, address(areas), *map(address, things), address(out)
    )
    return out
