"""C++ kernels for the loops in which NumPy is measured to be too slow (docs/architecture.md).

The kernels work on NumPy arrays, whose dtypes and numbers of dimensions the signatures show. A
wrong dtype or shape raises a TypeError. Lengths that differ, indices out of range, and values that
a docstring excludes raise a ValueError. Arrays that are not contiguous are copied, except arrays
that a kernel changes: these must be contiguous. Arguments of type `NDArray[Any]` may have any real
dtype. Where a docstring does not say otherwise:

- `depth_m` is a depth image (H, W); 0 or NaN = no measurement. Other images are as large.
- `points_map_m` are the points (H * W, 3) of its pixels in the map frame.
- `boxes_xyxy_px` are finite boxes (N, 4), `others_xyxy_px` others (M, 4).
- `ends` have the index after the last row of each part of a table; the last one is its length.
"""

from hoid_native._native import *  # noqa: F403  all names of the stub
from hoid_native.parameters import (
    Candidates,
    Gates,
    MatchThreshold,
    Pinhole,
    QueryConstraints,
    StereoParams,
)
