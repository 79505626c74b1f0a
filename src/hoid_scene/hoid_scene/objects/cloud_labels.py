"""Labels the points of the dense map with the classes of the mapped objects (decision 052)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import Float32Array, FloatArray, IntArray
from hoid_scene.dense.depth_view import voxel_keys
from hoid_scene.objects.mapped_object import MappedObject
from hoid_scene.objects.voxel_set import VOXEL_M

NO_CLASS = 0
"""The label of points that belong to no object."""
# A point belongs to an object if it is in the cell of one of its voxels, or beside it: noise of
# depth, and the two lattices of voxels, shift it by up to a voxel. Without the neighbors, half of
# the points of objects have no label; with 26 instead of 6, more labels are wrong (decision 052).
_AROUND = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])


class CloudLabels(NamedTuple):
    """The classes of the points of a cloud."""

    labels: NDArray[np.uint32]  # (N,) NO_CLASS, or 1 + the index of the class
    class_names: tuple[str, ...]


class CloudLabeler:
    """Labels points, and numbers the classes in the order in which they first appear.

    A class keeps its number until the map is discarded.
    """

    def __init__(self) -> None:
        self._class_names: list[str] = []

    def label(self, points_map_m: Float32Array, objects: Sequence[MappedObject]) -> CloudLabels:
        """Return the classes of points (N, 3); of two objects at a point, the smaller one counts.

        Args:
            points_map_m: The points, in the map frame.
            objects: The objects whose voxels count.
        """
        for item in objects:
            if item.class_name not in self._class_names:
                self._class_names.append(item.class_name)
        by_size = sorted(objects, key=lambda item: item.radius_m())
        numbers = [self._class_names.index(item.class_name) + 1 for item in by_size]
        labels = np.full(len(points_map_m), NO_CLASS, np.uint32)
        keys, owners = _cells_of([item.solid_points_map_m() for item in by_size])
        if len(keys):
            wanted = voxel_keys(points_map_m.astype(np.float64), VOXEL_M)
            rows = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            is_known = keys[rows] == wanted
            labels[is_known] = np.array(numbers)[owners[rows[is_known]]]
        return CloudLabels(labels, tuple(self._class_names))


def _cells_of(parts: Sequence[FloatArray]) -> tuple[IntArray, IntArray]:
    """Return the ascending keys (C,) of the cells near points, and the first part (C,) near each.

    Args:
        parts: Points (N, 3) of each part.
    """
    centers_m = np.concatenate([np.empty((0, 3)), *parts])[:, None] + _AROUND * VOXEL_M
    owners = np.repeat(np.arange(len(parts)), [len(_AROUND) * len(part) for part in parts])
    keys, first = np.unique(voxel_keys(centers_m.reshape(-1, 3), VOXEL_M), return_index=True)
    return keys, owners[first]
