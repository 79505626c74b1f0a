"""Finds the floor in a cloud: the lowest large level plane."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import FloatArray

NO_FLOOR = (
    'no floor has been seen, or walls and tables do not show which direction is up, so there is '
    'no grid: let the camera see the floor and two walls, or set base_frame (frames.base) and its '
    'place on /tf_static, or --mount ROLL PITCH YAW of "hoid run"'
)
"""Why there is no grid, and what to do."""
# Points less than this above the plane count as floor, which the boxes of furniture also show,
# between the legs. Chosen: more than the noise of the floor.
ON_FLOOR_M = 0.04
_TRIALS = 300  # largest number of level planes that are compared; not tuned
_SAMPLES_PER_TRIAL = 10  # triples of points per trial, because most planes are not level
_THICKNESS_M = 0.03  # not tuned: 3 standard deviations of depth at 1.8 m (see `depth_view.py`)
_MAX_TILT_RAD = np.deg2rad(20.0)  # not tuned: without a base frame the map is only nearly level
_MAX_SHARE_BELOW = 0.03  # largest ratio of points below the floor; a table has more; not tuned
_MIN_SHARE = 0.03  # smallest share of all points that lie on the floor; not tuned
# Chosen: smallest standard deviation of the floor's points across the direction in which they
# extend most. In a map that is tilted by 45 degrees, the lowest edge between floor and wall is a
# strip of about 0.03 m.
_MIN_WIDTH_M = 0.1
_MAX_POINTS = 6000  # chosen, to bound the time: all planes are compared with all points
_MIN_POINTS = 100  # not tuned: fewer points show no floor
_MIN_NORMAL_M2 = 1e-3  # twice the area of the smallest triangle that defines a plane: 5 cm2


class Floor(NamedTuple):
    """The floor: a plane in the map frame."""

    # (4, 4) pose of the floor frame: z along the upward normal, and as origin the point of the
    # plane that is nearest to the map's origin.
    T_map_floor: FloatArray

    @property
    def T_map_ground(self) -> FloatArray:  # noqa: N802 - a transform's name
        """Return the affine transform (4, 4) from the ground frame to the map frame.

        A point has the same x and y in the ground frame as in the map frame, and as z its height
        above the plane, so that a floor with a small slope in the map frame is level in it. The
        transform is not rigid.
        """
        T_ground_map = np.eye(4)
        normal = self.T_map_floor[:3, 2]
        T_ground_map[2] = *normal, -normal @ self.T_map_floor[:3, 3]
        return np.asarray(np.linalg.inv(T_ground_map), np.float64)

    def distance_m(self, point_m: FloatArray) -> float:
        """Return how far [m] a point (3,) of the map frame is above the plane."""
        return float(self.distances_m(point_m[None])[0])

    def distances_m(self, points_m: FloatArray) -> FloatArray:
        """Return how far [m] points (N, 3) of the map frame are above the plane: (N,)."""
        return np.asarray((points_m - self.T_map_floor[:3, 3]) @ self.T_map_floor[:3, 2])

    def height_m(self, x_m: float, y_m: float) -> float:
        """Return z [m] of the plane at a given x and y, all in the map frame."""
        normal, origin = self.T_map_floor[:3, 2], self.T_map_floor[:3, 3]
        return float((normal @ origin - normal[0] * x_m - normal[1] * y_m) / normal[2])


def find_floor(
    points_m: FloatArray, up: FloatArray, seed: int = 0, *, is_up_exact: bool = False
) -> Floor | None:
    """Return the floor in points (N, 3), map frame, found by RANSAC; None if there is none.

    The floor is the level plane with most points, among those that have almost all other points
    above them (RANSAC: Fischler and Bolles, CACM 1981). It is refitted by least squares. Planes
    that tilt by more than 20 degrees, narrow strips and planes with few points are no floor.

    Args:
        is_up_exact: Whether `up` is the normal of the floor, whose height alone is unknown.
    """
    rng = np.random.default_rng(seed)
    if len(points_m) > _MAX_POINTS:
        points_m = points_m[rng.choice(len(points_m), _MAX_POINTS, replace=False)]
    if len(points_m) < _MIN_POINTS:
        return None
    if is_up_exact:
        offsets = points_m[rng.integers(0, len(points_m), _TRIALS)] @ up
        normals = np.tile(up, (_TRIALS, 1))
    else:
        normals, offsets = _sample_planes(points_m, up, rng)
    if len(normals) == 0:
        return None
    heights = points_m @ normals.T - offsets  # (N, trials)
    on = (np.abs(heights) < _THICKNESS_M).mean(0)
    below = (heights < -2 * _THICKNESS_M).mean(0)
    score = np.where((below < _MAX_SHARE_BELOW) & (on > _MIN_SHARE), on, 0.0)
    best = int(np.argmax(score))
    if score[best] == 0:
        return None
    inliers = points_m[np.abs(heights[:, best]) < _THICKNESS_M]
    width_m = np.linalg.svd(inliers - inliers.mean(0), compute_uv=False)[1] / len(inliers) ** 0.5
    if width_m < _MIN_WIDTH_M:
        return None
    if is_up_exact:
        return Floor(_frame_on(up, float(np.median(inliers @ up))))
    normal, offset = _fit_plane(inliers, up)
    return Floor(_frame_on(normal, offset))


def _sample_planes(
    points_m: FloatArray, up: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return the upward unit normals (M, 3) and offsets (M,) of level planes.

    Each one passes through three random points. The offset [m] is the distance of the plane from
    the map's origin along the normal.
    """
    triples = points_m[rng.integers(0, len(points_m), (_TRIALS * _SAMPLES_PER_TRIAL, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    norm = np.linalg.norm(normals, axis=1)
    good = norm > _MIN_NORMAL_M2
    normals = normals[good] / norm[good, None]
    normals *= np.sign(normals @ up)[:, None]
    level = np.flatnonzero(normals @ up > np.cos(_MAX_TILT_RAD))[:_TRIALS]
    normals = normals[level]
    return normals, np.einsum('ij,ij->i', normals, triples[good][level, 0])


def _fit_plane(points_m: FloatArray, up: FloatArray) -> tuple[FloatArray, float]:
    """Return the least-squares plane of points (N, 3): its upward unit normal (3,) and offset [m].

    The offset is the distance of the plane from the map's origin along the normal.
    """
    center = points_m.mean(0)
    _, _, vt = np.linalg.svd(points_m - center, full_matrices=False)
    normal = vt[2] * np.sign(vt[2] @ up)
    return normal, float(normal @ center)


def _frame_on(normal: FloatArray, offset: float) -> FloatArray:
    """Return T_map_plane (4, 4) of a plane, with z along its normal and x close to the map's x."""
    x = np.array([1.0, 0, 0]) if abs(normal[0]) < 0.9 else np.array([0, 0, 1.0])
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(normal, x), normal], axis=1)
    T[:3, 3] = offset * normal
    return T
