"""Find the floor in a cloud: the lowest large plane that is level."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import FloatArray

_TRIALS = 300
_THICKNESS_M = 0.03
_MAX_TILT_RAD = np.deg2rad(20.0)
_MAX_SHARE_BELOW = 0.03  # of all points; more than that under a plane, and it is a table
_MIN_SHARE = 0.03  # of all points on the floor, less is not believed
_MAX_POINTS = 6000


class Floor(NamedTuple):
    """A level plane; `T_map_floor` has z up and its origin below the map's origin."""

    T_map_floor: FloatArray  # (4, 4)
    num_points: int

    @property
    def T_map_ground(self) -> FloatArray:  # noqa: N802 - a transform's name
        """Return (4, 4) to the map from its own x and y with the height above the plane as z.

        Where the map is level and the plane all but so, this levels what stands on it; no rigid
        motion, as x and y stay.
        """
        T_ground_map = np.eye(4)
        normal = self.T_map_floor[:3, 2]
        T_ground_map[2] = *normal, -normal @ self.T_map_floor[:3, 3]
        return np.asarray(np.linalg.inv(T_ground_map), np.float64)

    def height_m(self, x_m: float, y_m: float) -> float:
        """Return z of the plane at a place in the map."""
        normal, origin = self.T_map_floor[:3, 2], self.T_map_floor[:3, 3]
        return float((normal @ origin - normal[0] * x_m - normal[1] * y_m) / normal[2])


def find_floor(points_m: FloatArray, up: FloatArray, seed: int = 0) -> Floor | None:
    """Return the floor of (N, 3) points, or None when nothing level and low enough is seen.

    Args:
        up: (3,) unit vector, roughly against gravity.

    Source: RANSAC (Fischler and Bolles, 1981) with a least-squares refit.
    """
    rng = np.random.default_rng(seed)
    if len(points_m) > _MAX_POINTS:
        points_m = points_m[rng.choice(len(points_m), _MAX_POINTS, replace=False)]
    if len(points_m) < 100:
        return None
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
    normal, offset = _fit_plane(inliers, up)
    return Floor(_frame_on(normal, offset), len(inliers))


def _sample_planes(
    points_m: FloatArray, up: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    triples = points_m[rng.integers(0, len(points_m), (_TRIALS * 10, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    norm = np.linalg.norm(normals, axis=1)
    good = norm > 1e-3  # triangles of more than a few square centimetres
    normals = normals[good] / norm[good, None]
    normals *= np.sign(normals @ up)[:, None]
    level = np.flatnonzero(normals @ up > np.cos(_MAX_TILT_RAD))[:_TRIALS]
    normals = normals[level]
    return normals, np.einsum('ij,ij->i', normals, triples[good][level, 0])


def _fit_plane(points_m: FloatArray, up: FloatArray) -> tuple[FloatArray, float]:
    center = points_m.mean(0)
    _, _, vt = np.linalg.svd(points_m - center, full_matrices=False)
    normal = vt[2] * np.sign(vt[2] @ up)
    return normal, float(normal @ center)


def _frame_on(normal: FloatArray, offset: float) -> FloatArray:
    """Return the frame with z along the normal and x as near to the map's x as can be."""
    x = np.array([1.0, 0, 0]) if abs(normal[0]) < 0.9 else np.array([0, 0, 1.0])
    x = x - (x @ normal) * normal
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(normal, x), normal], axis=1)
    T[:3, 3] = offset * normal
    return T
