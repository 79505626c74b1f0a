"""Bundle adjustment of a window of keyframes and their points, by a dense solver.

The reduced camera system has six unknowns per keyframe. It is so small that a dense Schur
complement solves it many times faster than a general factor graph (decision 013).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

import hoid_native
from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from hoid_native.results import Observations
from rgbd_slam.config.slam_config import MappingConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.map_tables import NEAR_SHARED
from rgbd_slam.optimize.pose_optimizer import CHI2_MONO, CHI2_STEREO, GATES


@dataclass(frozen=True, eq=False)
class BundleProblem:
    """Keyframes, points and M observations as parallel arrays.

    A keyframe observes a point at most once. The outlier test uses `inv_sigma2` for u_right too.
    In the fit, the disparity u - u_right has its own variance, which follows from the camera's
    noise, unless that camera has `joint_noise`.
    """

    T_camera_map: FloatArray  # (C, 4, 4) poses of the keyframes
    num_free: int  # the first `num_free` keyframes are optimized, the others are fixed
    points_m: FloatArray  # (3, P) in the map frame
    camera: IntArray  # (M,) index of the keyframe of each observation
    point: IntArray  # (M,) index of the point of each observation
    measured_px: FloatArray  # (3, M) u, v, u_right; u_right is NaN without depth
    inv_sigma2: FloatArray  # (M,) 1 / variance of u and of v (1/px^2)


class BundleSolution(NamedTuple):
    """Adjusted poses and points, and which observations do not fit them."""

    T_camera_map: FloatArray  # (C, 4, 4)
    points_m: FloatArray  # (3, P)
    outliers: BoolArray  # (M,) True: the observation is an outlier


def adjust(
    camera: StereoCamera, problem: BundleProblem, iterations: int, rounds: int = 2
) -> BundleSolution:
    """Return adjusted poses and points; each round leaves out the outliers of the previous one.

    Residuals are weighted by the camera's noise, with a Huber kernel. A round has at most
    `iterations` iterations.
    """
    fit = hoid_native.adjust_bundle(
        camera.lens,
        GATES,
        problem.T_camera_map,
        problem.num_free,
        problem.points_m.T,
        problem.camera,
        problem.point,
        problem.measured_px.T,
        problem.inv_sigma2,
        rounds,
        iterations,
    )
    gate = np.where(np.isfinite(problem.measured_px[2]), CHI2_STEREO, CHI2_MONO)
    return BundleSolution(fit.T_camera_map, fit.points_m.T, fit.chi2 > gate)


def local_bundle_adjustment(
    atlas: Atlas, camera: StereoCamera, i: int, config: MappingConfig
) -> None:
    """Adjust keyframe `i`, the keyframes that share most points with it, and their points.

    The root of a map and up to `fixed_window` other keyframes that observe these points are fixed.
    Outliers among the observations are removed from the map.
    """
    free = np.concatenate([[i], atlas.covisible(i, NEAR_SHARED, config.window - 1)])
    root = atlas.keyframes.parent_uid[free] < 0
    fixed_root, free = free[root], free[~root]
    j = atlas.points_of(free)
    fixed = np.concatenate([fixed_root, _fixed_keyframes(atlas, j, free, config.fixed_window)])
    fixed = np.unique(fixed)
    if len(free) == 0 or len(fixed) == 0:
        return
    cameras = np.concatenate([free, fixed])
    _solve(atlas, camera, cameras, len(free), j, config)


def _fixed_keyframes(atlas: Atlas, j: IntArray, free: IntArray, limit: int) -> IntArray:
    """Return rows of at most `limit` other keyframes that observe most of the points `j`."""
    votes = np.bincount(atlas.observations_of(j).i, minlength=atlas.keyframes.capacity)
    votes[free] = 0
    order = np.argsort(-votes, kind='stable')[:limit]
    return order[votes[order] > 0]


def _solve(
    atlas: Atlas,
    camera: StereoCamera,
    cameras: IntArray,
    num_free: int,
    j: IntArray,
    config: MappingConfig,
) -> None:
    problem, seen = bundle_problem(atlas, cameras, num_free, j)
    solution = adjust(camera, problem, config.iterations, config.rounds)
    atlas.set_poses(cameras[:num_free], se3.inverse(solution.T_camera_map[:num_free]))
    atlas.set_positions(j, solution.points_m.T)
    _unobserve(atlas, Observations(*(part[solution.outliers] for part in seen)))
    atlas.refresh(j)


def bundle_problem(
    atlas: Atlas, cameras: IntArray, num_free: int, j: IntArray
) -> tuple[BundleProblem, Observations]:
    """Return the problem of keyframes (C,) and points (P,), and its M observations."""
    keyframes, points = atlas.keyframes, atlas.points
    seen = atlas.observations_of(j, cameras)
    problem = BundleProblem(
        se3.inverse(keyframes.T_map_camera[cameras]),
        num_free,
        np.ascontiguousarray(points.position_m[j].T),
        _positions(cameras, seen.i),
        _positions(j, seen.j),
        np.ascontiguousarray(keyframes.measurement_px[seen.i, seen.k].T, np.float64),
        atlas.octave_scale[keyframes.octave[seen.i, seen.k]] ** -2.0,
    )
    return problem, seen


def _positions(rows: IntArray, wanted: IntArray) -> IntArray:
    """Return the index (M,) of each `wanted` row in `rows` (N,)."""
    order = np.argsort(rows)
    return np.asarray(order[np.searchsorted(rows, wanted, sorter=order)])


def _unobserve(atlas: Atlas, seen: Observations) -> None:
    for i in np.unique(seen.i).tolist():
        atlas.unobserve(i, seen.k[seen.i == i])
