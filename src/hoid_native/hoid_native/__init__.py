"""C++ kernels for loops in which NumPy was measured to be too slow (docs/architecture.md).

The kernels work on NumPy arrays, whose dtypes and numbers of dimensions the signatures show. A
wrong dtype or shape raises a TypeError. Lengths that differ, indices out of range, and values that
a docstring excludes raise a ValueError. Arrays that are not contiguous are copied, except arrays
that a kernel changes: these must be contiguous. Arguments of type `NDArray[Any]` may have any real
dtype. Unless a docstring says otherwise:

- `depth_m` is a depth image (H, W); 0 or NaN = no measurement. Other images have the same size.
- `points_map_m` are the points (H * W, 3) of the depth image's pixels in the map frame.
- `boxes_xyxy_px` are boxes (N, 4) with finite corners, `others_xyxy_px` further ones (M, 4).
- `ends` hold the index after the last row of each part of a table.
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
