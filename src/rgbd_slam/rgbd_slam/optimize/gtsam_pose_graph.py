"""Keyframe poses tied by relative measurements, optimised by GTSAM's Levenberg-Marquardt."""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np

from hoid_common.values import FloatArray, IntArray


class PoseGraphSolution(NamedTuple):
    """Optimised poses, in order of `add_keyframe`."""

    uids: IntArray  # (N,)
    T_map_camera: FloatArray  # (N, 4, 4)
    error_before: float  # half the sum of squared residuals, in sigmas
    error_after: float


class PoseGraph:
    """A graph of keyframes; those added with `fixed` keep their pose."""

    def __init__(self) -> None:
        self._graph = gtsam.NonlinearFactorGraph()
        self._values = gtsam.Values()
        self._uids: list[int] = []

    def add_keyframe(self, uid: int, T_map_camera: FloatArray, *, fixed: bool = False) -> None:
        """Add a node with its present pose (4, 4); a graph needs at least one fixed one."""
        pose = gtsam.Pose3(T_map_camera)
        self._values.insert(uid, pose)
        self._uids.append(uid)
        if fixed:
            self._graph.add(gtsam.NonlinearEqualityPose3(uid, pose))

    def add_constraint(
        self, uid_a: int, uid_b: int, T_a_b: FloatArray, sigma_rad: float, sigma_m: float
    ) -> None:
        """Tie two keyframes by the pose (4, 4) of b relative to a and its standard deviations."""
        sigmas = np.repeat([sigma_rad, sigma_m], 3)  # GTSAM's twists, too, are rotation first
        noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        self._graph.add(gtsam.BetweenFactorPose3(uid_a, uid_b, gtsam.Pose3(T_a_b), noise))

    def optimize(self) -> PoseGraphSolution:
        """Return the poses of least error; every keyframe must be tied to a fixed one."""
        optimizer = gtsam.LevenbergMarquardtOptimizer(self._graph, self._values)
        before = optimizer.error()
        poses = optimizer.optimize()
        stacked = [poses.atPose3(uid).matrix() for uid in self._uids]
        return PoseGraphSolution(
            np.array(self._uids, np.int64),
            np.array(stacked).reshape(-1, 4, 4),
            before,
            optimizer.error(),
        )
