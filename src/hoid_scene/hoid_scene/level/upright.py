"""Finds the direction up in a map that no accelerometer and no base frame has made level.

In a building, most surfaces are horizontal (floor, ceiling, tables) or vertical (walls): the
direction up is parallel to the normals of the first and perpendicular to those of the second, as
in a "Manhattan world" (Coughlan and Yuille, ICCV 1999) whose walls may have any heading. Such a
world has several directions that agree as well, for example along a corridor. Which of them is up
follows from the poses of the camera, which is carried with little roll and looks ahead or down.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import FloatArray

_CELL_M = 0.15  # side of the cells in which a plane is fitted; chosen: six voxels
# Smallest number of points of a cell; chosen: a third of the voxels of a plane through it.
_MIN_POINTS = 12
_MAX_POINTS = 60_000  # chosen, to bound the time
_MAX_CELLS = 600  # chosen, to bound the time: all directions are compared with all cells
# Chosen: a cell is planar if the variance of its points across the plane is less than the first
# ratio of the smaller variance along it, and this is more than the second ratio of the larger one.
_MAX_THICKNESS, _MIN_WIDTH = 0.15, 0.15
_MIN_CELLS = 12  # chosen: fewer planar cells do not show which direction is up
_NUM_DIRECTIONS = 5000  # on the sphere, 3 degrees apart
# Standard deviations: of the normals of cells while directions are compared, and while the best
# one is refined; of the camera's roll; of its pitch. Then the mean pitch, downwards. Chosen: noise
# of depth tilts the plane of a cell by some degrees; recordings by hand roll by up to 15 and pitch
# by -20 to 60.
_NORMAL_RAD, _REFINED_RAD = np.deg2rad(6.0), np.deg2rad(4.0)
_ROLL_RAD, _PITCH_RAD, _DOWN_RAD = np.deg2rad(10.0), np.deg2rad(30.0), np.deg2rad(15.0)
# Weight of the camera's poses. Chosen: poses that deviate by one standard deviation cost as much
# as a tenth of the surfaces that are neither horizontal nor vertical.
_PRIOR_WEIGHT = 0.1
_NUM_REFINEMENTS = 10
# Chosen: smallest ratio of the surfaces that must be horizontal or vertical. In clutter without
# structure, a fifth of the surfaces is so for any up direction.
_MIN_AGREEMENT = 0.4
# The up direction is certain if more than this ratio of the surfaces is horizontal, or is vertical
# with another heading than most walls: a single wall leaves the rotation about its normal open.
_MIN_SECOND = 0.04
_MIN_HEADING = (
    0.4  # chosen: smallest length of the mean of the walls' headings; 0 for a round room
)


class Upright(NamedTuple):
    """The direction up, and how far the surfaces agree with it."""

    up: FloatArray  # (3,) unit vector in the map frame
    horizontal: float  # ratio of the planar surface that is horizontal
    vertical: float  # ratio of the planar surface that is vertical
    is_certain: bool  # False: surfaces leave a rotation open; the camera's poses decide
    wall: FloatArray | None  # (3,) horizontal unit vector along most walls; None: no heading


def find_upright(
    points_m: FloatArray,
    T_map_cameras: FloatArray,
    known_up: FloatArray | None = None,
    seed: int = 0,
) -> Upright | None:
    """Return the direction up in a cloud; None if too few of its surfaces are planes.

    Args:
        known_up: (3,) the direction up, if an accelerometer or a base frame shows it; the result
            then says only how far the surfaces agree, and where the walls are.
    """
    normals, weights = _planes(points_m, np.random.default_rng(seed))
    if len(normals) < _MIN_CELLS:
        return None
    if known_up is not None:
        return _judged(known_up, normals, weights)
    directions = _directions(_NUM_DIRECTIONS)
    agreement = _agreement(directions, normals, _NORMAL_RAD) @ weights
    cost = _camera_cost(directions, T_map_cameras)
    up = directions[int(np.argmax(agreement - _PRIOR_WEIGHT * cost))]
    up = _refined(up, normals, weights, T_map_cameras)
    return _judged(up, normals, weights)


def _planes(points_m: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return unit normals (M, 3) of planar cells of a cloud, and the ratio (M,) of points in each.

    The sign of a normal is arbitrary. Excess points and cells are dropped at random.
    """
    if len(points_m) > _MAX_POINTS:
        points_m = points_m[rng.choice(len(points_m), _MAX_POINTS, replace=False)]
    normals, weights = _plane_cells(points_m) if len(points_m) else (points_m, points_m[:, 0])
    if len(normals) > _MAX_CELLS:
        chosen = rng.choice(len(normals), _MAX_CELLS, replace=False)
        normals, weights = normals[chosen], weights[chosen]
    return normals, weights / max(weights.sum(), 1.0)


def _plane_cells(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the unit normals (M, 3) of all planar cells, and their numbers of points (M,)."""
    index = np.floor(points_m / _CELL_M).astype(np.int64)
    index -= index.min(axis=0)
    key = np.ravel_multi_index(tuple(index.T), tuple(index.max(axis=0) + 1))
    _, cell, count = np.unique(key, return_inverse=True, return_counts=True)
    num = len(count)

    def means(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(cell, values, num) / count)

    center = np.stack([means(points_m[:, axis]) for axis in range(3)], axis=1)
    offset = points_m - center[cell]
    moments = np.array([[means(offset[:, a] * offset[:, b]) for b in range(3)] for a in range(3)])
    is_full = count >= _MIN_POINTS
    variances, axes = np.linalg.eigh(moments.transpose(2, 0, 1)[is_full])
    thin, narrow, wide = variances.T
    is_plane = (thin < _MAX_THICKNESS * narrow) & (narrow > _MIN_WIDTH * wide)
    return axes[is_plane, :, 0], count[is_full][is_plane].astype(np.float64)


def _directions(count: int) -> FloatArray:
    """Return unit vectors (count, 3), evenly distributed on the sphere (Fibonacci lattice)."""
    n = np.arange(count) + 0.5
    z, angle = 1 - 2 * n / count, np.pi * (1 + 5**0.5) * n
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def _agreement(up: FloatArray, normals: FloatArray, sigma_rad: float) -> FloatArray:
    """Return the agreement (D, M), from 0 to 1, of M surfaces with D directions up."""
    cosine = np.abs(up @ normals.T).clip(0.0, 1.0)
    from_vertical_rad = np.arcsin(cosine)  # 0 for a wall
    off_rad = np.minimum(from_vertical_rad, np.pi / 2 - from_vertical_rad)
    return np.asarray(np.exp(-0.5 * (off_rad / sigma_rad) ** 2))


def _camera_cost(up: FloatArray, T_map_cameras: FloatArray) -> FloatArray:
    """Return (D,) how unusual the camera's roll and pitch are for directions (D, 3).

    It is the mean of the squared deviations in standard deviations.
    """
    right, down, ahead = (T_map_cameras[:, :3, axis] for axis in range(3))
    roll_rad = np.arcsin((up @ right.T).clip(-1, 1))
    pitch_rad = np.arctan2(-(up @ ahead.T), -(up @ down.T))  # beyond 90 degrees: upside down
    cost = (roll_rad / _ROLL_RAD) ** 2 + ((pitch_rad - _DOWN_RAD) / _PITCH_RAD) ** 2
    return np.asarray(cost.mean(axis=1))


def _refined(
    up: FloatArray, normals: FloatArray, weights: FloatArray, T_map_cameras: FloatArray
) -> FloatArray:
    """Return the direction nearest to `up` that fits the surfaces best (reweighted least squares).

    Where the surfaces do not constrain the direction, the smallest roll of the camera decides.
    """
    right = T_map_cameras[:, :3, 0]
    level = right.T @ right / len(right) * (_REFINED_RAD / _ROLL_RAD) ** 2 * _PRIOR_WEIGHT
    for _ in range(_NUM_REFINEMENTS):
        agreeing = weights * _agreement(up[None], normals, _REFINED_RAD)[0]
        is_horizontal = np.abs(normals @ up) > np.sqrt(0.5)
        outer = (normals * agreeing[:, None]).T
        walls = outer[:, ~is_horizontal] @ normals[~is_horizontal]
        floors = outer[:, is_horizontal] @ normals[is_horizontal]
        off = walls + agreeing[is_horizontal].sum() * np.eye(3) - floors + level
        axis = np.linalg.eigh(off)[1][:, 0]
        up = axis * np.sign(axis @ up)
    return up


def _judged(up: FloatArray, normals: FloatArray, weights: FloatArray) -> Upright | None:
    agreeing = weights * _agreement(up[None], normals, _REFINED_RAD)[0]
    is_horizontal = np.abs(normals @ up) > np.sqrt(0.5)
    horizontal, walls = agreeing[is_horizontal].sum(), np.flatnonzero(~is_horizontal)
    vertical = agreeing[walls].sum()
    if horizontal + vertical < _MIN_AGREEMENT:
        return None
    # Of walls with two headings, the second moment has two large eigenvalues.
    moment = (normals[walls] * agreeing[walls, None]).T @ normals[walls]
    second = float(np.linalg.eigvalsh(moment)[1])
    is_certain = max(horizontal, second) > _MIN_SECOND
    wall = _heading(up, normals[walls], agreeing[walls])
    return Upright(up, float(horizontal), float(vertical), bool(is_certain), wall)


def _heading(up: FloatArray, normals: FloatArray, weights: FloatArray) -> FloatArray | None:
    """Return the horizontal unit vector (3,) along the walls; None if their headings differ.

    Walls meet at right angles, so that four times the angle of a normal is the same for all of
    them. The heading is a quarter of the mean of these angles over the normals (M, 3).
    """
    x = np.array([1.0, 0, 0]) if abs(up[0]) < 0.9 else np.array([0, 1.0, 0])
    x = x - (x @ up) * up
    x /= np.linalg.norm(x)
    y = np.cross(up, x)
    mean = (weights * np.exp(4j * np.arctan2(normals @ y, normals @ x))).sum()
    if np.abs(mean) < _MIN_HEADING * max(weights.sum(), _MIN_SECOND):
        return None
    angle_rad = np.angle(mean) / 4
    return np.asarray(np.cos(angle_rad) * x + np.sin(angle_rad) * y)
