"""A pose graph of keyframes, which GTSAM optimizes by Levenberg-Marquardt."""

from __future__ import annotations

import gtsam
import numpy as np

from hoid_common.values import FloatArray


class PoseGraph:
    """Keyframes connected by measured relative poses; the poses of fixed ones do not change."""

    def __init__(self) -> None:
        self._graph = gtsam.NonlinearFactorGraph()
        self._values = gtsam.Values()
        self._uids: list[int] = []

    def add_keyframe(self, uid: int, T_map_camera: FloatArray, *, fixed: bool = False) -> None:
        """Add a keyframe with its initial pose T_map_camera (4, 4); at least one must be fixed."""
        pose = gtsam.Pose3(T_map_camera)
        self._values.insert(uid, pose)
        self._uids.append(uid)
        if fixed:
            self._graph.add(gtsam.NonlinearEqualityPose3(uid, pose))

    def add_constraint(
        self, uid_a: int, uid_b: int, T_a_b: FloatArray, sigma_rad: float, sigma_m: float
    ) -> None:
        """Connect two keyframes by a measured pose T_a_b (4, 4) with these standard deviations."""
        # Rotation first, as in GTSAM's twists.
        sigmas = np.repeat([sigma_rad, sigma_m], 3)
        noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
        self._graph.add(gtsam.BetweenFactorPose3(uid_a, uid_b, gtsam.Pose3(T_a_b), noise))

    def add_measurement(
        self, uid_a: int, uid_b: int, T_a_b: FloatArray, covariance: FloatArray
    ) -> None:
        """Connect two keyframes by T_a_b (4, 4) with a covariance (6, 6) in b, rotation first."""
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        self._graph.add(gtsam.BetweenFactorPose3(uid_a, uid_b, gtsam.Pose3(T_a_b), noise))

    def optimize(self) -> FloatArray:
        """Return the optimized T_map_camera (N, 4, 4); each must be connected with a fixed one."""
        poses = gtsam.LevenbergMarquardtOptimizer(self._graph, self._values).optimize()
        return np.array([poses.atPose3(uid).matrix() for uid in self._uids]).reshape(-1, 4, 4)
