"""Labels the points of the dense map with the classes of objects (decision 052)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import Float32Array, FloatArray
from hoid_scene.dense.depth_view import voxel_keys

NO_CLASS = 0
"""The label of points that belong to no object."""
# A point gets the label of an object if it is in the cell of one of the object's voxels, or in one
# of the 6 cells beside it: noise of depth, and the different lattices of the dense map and the
# object, shift it by up to a voxel. Without these neighbors, half of the points of objects have no
# label; with 26 neighbors, more labels are wrong (decision 052).
_AROUND = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
_CELL_M = 0.025  # the side of a voxel of an object


class CloudLabels(NamedTuple):
    """The classes of the points of a cloud."""

    labels: NDArray[np.uint32]  # (N,) label of each point: NO_CLASS, or 1 + index in `class_names`
    class_names: tuple[str, ...]  # name of the class by label - 1; '': unused


class CloudLabeler:
    """Labels points with the classes of objects, and assigns a number to each class.

    A class keeps its number while it has objects; afterwards another class may get the number.
    """

    def __init__(self) -> None:
        self._class_names: list[str] = []

    def label(
        self,
        points_map_m: Float32Array,
        objects: Sequence[tuple[str, FloatArray]],
        classes: Sequence[str],
    ) -> CloudLabels:
        """Return the labels of points (N, 3), map frame; the first of overlapping objects counts.

        Args:
            objects: Class and points (M, 3) of each object at rest, in the map frame.
        """
        self._class_names = [name if name in classes else '' for name in self._class_names]
        for name in classes:
            if name not in self._class_names:
                free = [*self._class_names, ''].index('')
                self._class_names[free : free + 1] = [name]
        labels = np.full(len(points_map_m), NO_CLASS, np.uint32)
        parts = [np.empty((0, 3)), *(points_m for _, points_m in objects)]
        cells_m = np.concatenate(parts)[:, None] + _AROUND * _CELL_M
        numbers = [self._class_names.index(name) + 1 for name, _ in objects]
        owners = np.repeat(numbers, [len(_AROUND) * len(points_m) for points_m in parts[1:]])
        keys, first = np.unique(voxel_keys(cells_m.reshape(-1, 3), _CELL_M), return_index=True)
        if len(keys):
            wanted = voxel_keys(points_map_m.astype(np.float64), _CELL_M)
            rows = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            is_known = keys[rows] == wanted
            labels[is_known] = owners[first[rows[is_known]]]
        return CloudLabels(labels, tuple(self._class_names))
