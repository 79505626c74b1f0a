"""The surface of one object of the map: voxels in a frame that moves with a keyframe."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.linalg import norm

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from hoid_native import pixels_on_surface, share_on_surface, voxel_keys
from hoid_scene.grid.floor import ON_FLOOR_M, Floor
from hoid_scene.level.upright_box import Level, UprightBox, extended_back, on_floor, upright_box
from hoid_scene.objects.object_view import NOISE_PER_M2, ObjectView
from hoid_scene.objects.segmentation import BoxPx, KnownBox, Segment
from hoid_scene.objects.voxel_set import BITS, VoxelSet, trimmed_box
from hoid_scene.place import Place

# Numbers without a source were not tuned.
_OUTER_RATIO = 0.02  # ratio of voxels on each side of each axis that the box leaves out
_CELL_M = 0.05  # side of the cells of the surface of an object
_CELL_SIGMAS = 2.0  # side of the cells in which hits are counted, in standard deviations of depth
# By how much a known object may grow on each side in a look: length, and ratio of its size.
_GROWTH_M, _GROWTH_RATIO = 0.05, 0.15
_MIN_DISTANCE_M = 1e-6  # avoids a division by zero
# Chosen: points on the floor are left out if at least this ratio of all points is above it.
_MIN_ABOVE_RATIO = 0.15
_SAME_UP = 0.01  # chosen: 0.6 degrees; a box is fitted again if the vertical turns by more


class _Fitted(NamedTuple):
    level: Level
    floor: Floor | None
    box: UprightBox


class ObjectSurface:
    """The surface of an object at one place, measured in many images.

    Attributes:
        place: The object frame.
        voxels: The voxels, in the object frame.
        num_looks: Number of images that measured it.
        direction_m: (3,) sum over these images of the unit vectors from the camera to it, in the
            object frame.
        distance_m: Sum of the distances from the camera.
        is_cut: Whether the border of the image has cut it in each of these images.
    """

    def __init__(self, place: Place) -> None:
        self.place, self.voxels = place, VoxelSet()
        self.num_looks, self.is_cut = 0, True
        self.direction_m: FloatArray = np.zeros(3)
        self.distance_m = 0.0
        self._forget_derived()

    def _forget_derived(self) -> None:
        self._box: tuple[FloatArray, FloatArray] | None = None
        self._center_m, self._radius_m = np.zeros(3), 0.0
        self._upright: _Fitted | None = None
        self._solid: BoolArray | None = None
        self._cells: IntArray | None = None

    @property
    def T_map_object(self) -> FloatArray:  # noqa: N802 - a transform's name
        return self.place.T_map_place

    def box_m(self) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and the highest corner (3,) [m] of the measured box, object frame.

        It is the bounding box of the solid voxels, or of all voxels if none is solid, without the
        2 % outermost ones on each side.
        """
        if self._box is None:
            solid = self.is_solid()
            points_m = self.voxels.means_m[solid] if solid.any() else self.voxels.means_m
            low, high = self._box = trimmed_box(points_m, _OUTER_RATIO)
            self._center_m, self._radius_m = (low + high) / 2, float(norm(high - low)) / 2
        return self._box

    def is_solid(self) -> BoolArray:
        """Return the (N,) mask of the voxels that belong to the object."""
        if self._solid is None:
            mean_m = self.distance_m / max(self.num_looks, 1)
            cell_m = _CELL_SIGMAS * NOISE_PER_M2 * mean_m**2
            self._solid = self.voxels.solid(self.num_looks, cell_m)
        return self._solid

    def known_box(self) -> KnownBox:
        low, high = self.box_m()
        margin = _GROWTH_M + _GROWTH_RATIO * (high - low)
        return KnownBox(self.place.T_place_map, low - margin, high + margin)

    def points_map_m(self) -> FloatArray:
        """Return the (N, 3) mean points of all voxels in the map frame."""
        return se3.transform(self.T_map_object, self.voxels.means_m)

    def solid_points_map_m(self) -> FloatArray:
        """Return the mean points (N, 3) of the object's solid voxels, in the map frame."""
        return se3.transform(self.T_map_object, self.voxels.means_m[self.is_solid()])

    def center_map_m(self) -> FloatArray:
        """Return the center (3,) of the measured box in the map frame."""
        self.box_m()
        T = self.T_map_object
        return np.asarray(T[:3, :3] @ self._center_m + T[:3, 3])

    def radius_m(self) -> float:
        """Return the radius [m] of the sphere around the measured box."""
        self.box_m()
        return self._radius_m

    def contains(self, points_map_m: FloatArray, margin_m: float) -> float:
        """Return the ratio of points (N, 3) of the map frame that are in the measured box."""
        low, high = self.box_m()
        local_m = se3.transform(self.place.T_place_map, points_map_m)
        is_inside = ((local_m > low - margin_m) & (local_m < high + margin_m)).all(axis=1)
        return int(np.count_nonzero(is_inside)) / max(len(points_map_m), 1)

    def pixels(self, view: ObjectView, box_px: BoxPx) -> IntArray:
        """Return the flat indices (M,) of strided pixels in a box that show the surface."""
        return pixels_on_surface(view.depth_m, view.points_map_m, box_px, *self._solid_cells())

    def ratio_near(self, points_map_m: FloatArray) -> float:
        """Return the ratio of points (N, 3) of the map frame that are near the surface."""
        return share_on_surface(points_map_m, *self._solid_cells())

    def _solid_cells(self) -> tuple[FloatArray, IntArray, float, int]:
        if self._cells is None:
            solid_m = self.voxels.means_m[self.is_solid()]
            self._cells = np.unique(voxel_keys(solid_m, _CELL_M, BITS))
        return self.place.T_place_map, self._cells, _CELL_M, BITS

    def ray_to(self, segment: Segment, T_map_camera: FloatArray) -> tuple[FloatArray, float]:
        """Return the unit vector (3,), object frame, and distance [m] from camera to segment."""
        ray_m = self.T_map_object[:3, :3].T @ (segment.center_map_m - T_map_camera[:3, 3])
        distance_m = max(float(norm(ray_m)), _MIN_DISTANCE_M)
        return np.asarray(ray_m / distance_m), distance_m

    def add(self, segment: Segment, T_map_camera: FloatArray) -> None:
        """Add the surface that a segment of an image shows."""
        self.voxels.add_points(se3.transform(self.place.T_place_map, segment.points_map_m))
        self.num_looks += 1
        self.is_cut &= segment.is_cut
        ray, distance_m = self.ray_to(segment, T_map_camera)
        self.direction_m = self.direction_m + ray
        self.distance_m += distance_m
        self._forget_derived()

    def count_misses(self, rows: IntArray) -> None:
        """Count an image as evidence that the voxels `rows` (M,) do not belong to the object."""
        self.voxels.misses[rows] += 1
        self._forget_derived()

    def absorb(self, other: ObjectSurface) -> FloatArray:
        """Add another surface; return the rotation (3, 3) from its frame to this one."""
        T = self.place.T_place_map @ other.T_map_object
        self.voxels.merge(other.voxels.moved(T))
        self.num_looks += other.num_looks
        self.is_cut &= other.is_cut
        self.direction_m = self.direction_m + T[:3, :3] @ other.direction_m
        self.distance_m += other.distance_m
        self._forget_derived()
        return np.asarray(T[:3, :3])

    def upright_box(self, level: Level, floor: Floor | None) -> UprightBox:
        """Return the upright box, object frame, extended to the back that was never seen."""
        level = level.turned(self.T_map_object[:3, :3].T)
        known = self._upright
        is_known = known is not None and known.floor is floor
        if known is None or not is_known or np.abs(known.level.up - level.up).max() > _SAME_UP:
            solid = self.is_solid()
            means_m = self.voxels.means_m[solid] if solid.any() else self.voxels.means_m
            if floor is not None:
                means_m = self._above(floor, means_m)
            known = self._upright = _Fitted(level, floor, upright_box(means_m, level))
        box = extended_back(known.box, self.direction_m / max(self.num_looks, 1))
        if floor is None:
            return box
        center_m = se3.transform(self.T_map_object, box.center_m[None])[0]
        return on_floor(box, floor.distance_m(center_m))

    def _above(self, floor: Floor, means_m: FloatArray) -> FloatArray:
        """Return the points (N, 3), object frame, above the floor, or all if too few are."""
        heights_m = floor.distances_m(se3.transform(self.T_map_object, means_m))
        is_above = heights_m > ON_FLOOR_M
        return means_m[is_above] if is_above.mean() >= _MIN_ABOVE_RATIO else means_m
