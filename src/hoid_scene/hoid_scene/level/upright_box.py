"""The upright box of an object, with the heading that fits its footprint."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import FloatArray

_OUTER_RATIO = 0.02  # ratio of the points on each side of each axis that the box leaves out
_MAX_POINTS = 400  # chosen, to bound the time to compare headings
# Headings that are compared: first 3 degrees apart, then 0.5 degrees apart around the best one.
_COARSE_RAD = np.deg2rad(np.arange(0.0, 90.0, 3.0))
_FINE_RAD = np.deg2rad(np.arange(-2.5, 3.0, 0.5))
# A box along the walls is preferred if its misfit is at most this factor larger than that of the
# best box. Chosen: the noise of depth changes the footprint of a chair by as much.
_ALONG_WALLS = 1.1
_MIN_SIDE_M = 0.02  # chosen: smallest side in the misfit, because of noise; a screen is thicker
# Assumed thickness of an object whose back was never seen; its width if that is smaller (as in
# `object_sighting`).
_HIDDEN_M = 0.15
_MAX_LIFT_M = 1.0  # chosen: a box with a lowest side above this is not extended to the floor
# The mean of the unit viewing directions of an object is long if all are alike: from this length
# on, only one side of the object was seen.
_ONE_SIDED = 0.9


class Level(NamedTuple):
    """The vertical in a frame, and the heading of the walls."""

    up: FloatArray  # (3,) unit vector
    wall: FloatArray | None = None  # (3,) horizontal unit vector along most walls; None: unknown

    def turned(self, R_new_old: FloatArray) -> Level:
        """Return the same vertical and heading in another frame, turned by a rotation (3, 3)."""
        wall = None if self.wall is None else R_new_old @ self.wall
        return Level(R_new_old @ self.up, wall)


class UprightBox(NamedTuple):
    """A box whose third axis points up."""

    axes: FloatArray  # (3, 3) unit vectors of its sides as columns; the third one points up
    low_m: FloatArray  # (3,) lowest corner along the axes
    high_m: FloatArray  # (3,) highest corner along the axes

    @property
    def size_m(self) -> FloatArray:
        """Return the (3,) extents along the axes."""
        return self.high_m - self.low_m

    @property
    def pose(self) -> FloatArray:
        """Return the pose (4, 4) of the center and the axes, in the frame of the points."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.axes, self.center_m
        return T

    @property
    def center_m(self) -> FloatArray:
        """Return the center (3,), in the frame of the points."""
        return np.asarray(self.axes @ (self.low_m + self.high_m) / 2)


def upright_box(points_m: FloatArray, level: Level) -> UprightBox:
    """Return the upright box of points (N, 3), N > 0, whose footprint fits best.

    The outermost 2 % of the points on each side of each axis are left out. A box along the walls
    is preferred if its footprint is at most 10 % worse: a round footprint has no heading. The
    first axis is the horizontal axis nearest to the x axis of the frame.
    """
    level_axes = _level_axes(level)
    some_m = points_m[:: -(-len(points_m) // _MAX_POINTS)] @ level_axes[:, :2]
    best_rad = _best(some_m, _COARSE_RAD)
    best_rad = _best(some_m, best_rad + _FINE_RAD)
    along, best = _misfits_m2(some_m, np.array([0.0, best_rad]))
    if level.wall is not None and along <= _ALONG_WALLS * best:
        best_rad = 0.0
    cosine, sine = np.cos(best_rad), np.sin(best_rad)
    turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    axes = _nearest_to_frame(level_axes @ turn)
    low, high = _trimmed(points_m @ axes)
    return UprightBox(axes, low, high)


def extended_back(box: UprightBox, direction: FloatArray) -> UprightBox:
    """Return the box of an object that was seen from one side only, extended away from the camera.

    Args:
        direction: (3,) mean of the unit vectors from the camera to the object, in the frame of the
            points.
    """
    along = direction @ box.axes[:, :2]
    if np.linalg.norm(along) < _ONE_SIDED:
        return box
    axis = int(np.argmax(np.abs(along)))
    thickness_m = min(float(box.size_m[1 - axis]), _HIDDEN_M)
    hidden_m = max(thickness_m - float(box.size_m[axis]), 0.0)
    low, high = box.low_m.copy(), box.high_m.copy()
    if along[axis] > 0:
        high[axis] += hidden_m
    else:
        low[axis] -= hidden_m
    return box._replace(low_m=low, high_m=high)


def on_floor(box: UprightBox, height_m: float) -> UprightBox:
    """Return the box, extended to the floor `height_m` below its center: legs are rarely seen.

    A box whose lowest side is more than 1 m above the floor is returned unchanged.
    """
    floor_m = float(box.low_m[2] + box.high_m[2]) / 2 - height_m
    if box.low_m[2] - floor_m >= _MAX_LIFT_M:
        return box
    low = box.low_m.copy()
    low[2] = min(low[2], floor_m)
    return box._replace(low_m=low)


def _level_axes(level: Level) -> FloatArray:
    """Return axes (3, 3) as columns: the first along the walls, the third one up."""
    x = np.array([1.0, 0, 0]) if abs(level.up[0]) < 0.9 else np.array([0, 1.0, 0])
    x = x if level.wall is None else level.wall
    x = x - (x @ level.up) * level.up
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(level.up, x), level.up], axis=1)


def _nearest_to_frame(axes: FloatArray) -> FloatArray:
    x, y, up = axes.T
    turned = max((x, y, -x, -y), key=lambda axis: float(axis[0]))
    return np.stack([turned, np.cross(up, turned), up], axis=1)


def _best(xy_m: FloatArray, headings_rad: FloatArray) -> float:
    return float(headings_rad[np.argmin(_misfits_m2(xy_m, headings_rad))])


def _misfits_m2(xy_m: FloatArray, headings_rad: FloatArray) -> FloatArray:
    """Return how badly rectangles with headings (H,) fit a footprint (N, 2).

    The misfit is the area, increased by up to a half the farther the points are from the nearest
    side. Area alone cannot tell the sides of an L (two visible sides of an object) from its
    diagonal (Zhang et al., "Efficient L-Shape Fitting for Vehicle Detection", IV 2017).
    """
    cosine, sine = np.cos(headings_rad), np.sin(headings_rad)
    sides_m, gaps_m = [], []
    for axis in ((cosine, sine), (-sine, cosine)):
        along_m = xy_m @ np.array(axis)  # (N, H)
        low, high = _trimmed(along_m)
        sides_m.append(high - low)
        gaps_m.append(np.minimum(np.abs(along_m - low), np.abs(high - along_m)))
    narrow_m = np.maximum(np.minimum(*sides_m), _MIN_SIDE_M)
    hollow = np.minimum(*gaps_m).mean(axis=0) / narrow_m  # 0.5 if all points are in the middle
    return np.asarray(
        np.maximum(sides_m[0], _MIN_SIDE_M) * np.maximum(sides_m[1], _MIN_SIDE_M) * (1 + hollow)
    )


def _trimmed(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest of N values (N, ...) per column, without the outermost 2 %."""
    ordered = np.sort(values, axis=0)
    left_out = int(_OUTER_RATIO * len(values))
    return ordered[left_out], ordered[-1 - left_out]
