"""Bundle adjustment of a window of keyframes: Levenberg-Marquardt with a dense Schur complement.

A window's reduced camera system is small (6 unknowns a keyframe), and its camera-point blocks fit
in one dense matrix, so that numpy solves it 10 times faster than a general factor graph
(docs/architecture.md). Triggs et al., Bundle Adjustment - A Modern Synthesis, 2000, sec. 6.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from rgbd_slam.frame import StereoCamera
from rgbd_slam.pose_optimizer import CHI2_MONO, CHI2_STEREO, MIN_DEPTH_M
from rgbd_slam.projection import point_jacobian, pose_jacobian, project

_FIRST_DAMPING = 1e-5
_MIN_DAMPING = 1e-9
_MAX_DAMPING = 1e3
_CONVERGED = 1e-4  # relative decrease of the cost
_PIVOT = 1e-12


@dataclass(frozen=True, eq=False)
class BundleProblem:
    """A window as parallel arrays; observations are sorted by camera, the free cameras come first.

    Attributes:
        T_camera_map: (C, 4, 4), the first `num_free` are moved.
        num_free: how many cameras move.
        points_m: (3, P).
        camera: (M,) which camera observes.
        point: (M,) which point; once a camera at most.
        measured_px: (3, M) u, v, u_right; NaN for u_right without depth.
        inv_sigma2: (M,) 1 / variance of each coordinate [1/px^2].
    """

    T_camera_map: FloatArray
    num_free: int
    points_m: FloatArray
    camera: IntArray
    point: IntArray
    measured_px: FloatArray
    inv_sigma2: FloatArray


class BundleSolution(NamedTuple):
    """Adjusted poses and points, and which observations do not fit them."""

    T_camera_map: FloatArray  # (C, 4, 4)
    points_m: FloatArray  # (3, P)
    outliers: BoolArray  # (M,)
    cost_before: float
    cost_after: float


def adjust(camera: StereoCamera, problem: BundleProblem, iterations: int) -> BundleSolution:
    """Adjust with a Huber kernel, leave out what does not fit, and adjust again."""
    bundle = _Bundle(camera, problem)
    before = bundle.minimize(iterations)
    bundle.drop_outliers()
    bundle.minimize(iterations)
    chi2 = bundle.chi2()
    T = np.stack([se3.orthonormalized(T) for T in bundle.T])
    return BundleSolution(T, bundle.points_m, chi2 > bundle.gate, before, bundle.cost(chi2))


class _System(NamedTuple):
    """The normal equations of one linearisation, arrays over free cameras C and points P."""

    H_cc: FloatArray  # (C, 6, 6)
    g_c: FloatArray  # (C, 6)
    H_pp: FloatArray  # (6, P): xx xy xz yy yz zz
    g_p: FloatArray  # (3, P)
    H_cp: FloatArray  # (C, 6, 3, P)


class _Bundle:
    """The state of one adjustment."""

    def __init__(self, camera: StereoCamera, problem: BundleProblem) -> None:
        self._camera = camera
        self._problem = problem
        self.T = problem.T_camera_map.copy()
        self.points_m = problem.points_m.copy()
        stereo = np.isfinite(problem.measured_px[2])
        self._no_depth = ~stereo
        self.gate = np.where(stereo, CHI2_STEREO, CHI2_MONO)
        self._measured = np.where(np.isfinite(problem.measured_px), problem.measured_px, 0.0)
        self._weight = np.repeat(problem.inv_sigma2[None], 3, axis=0)
        self._weight[2, ~stereo] = 0.0
        count = np.bincount(problem.camera, minlength=len(self.T))
        ends = np.cumsum(count)
        self._slices = [slice(int(e - n), int(e)) for e, n in zip(ends, count, strict=True)]
        self._num_free_obs = int(ends[problem.num_free - 1])
        m = len(problem.camera)
        self._x = np.empty((3, m))
        self._residual = np.empty((3, m))
        self._J_x = np.empty((3, 3, m))
        self._J_map = np.empty((3, 3, m))
        self._J_c = np.empty((6, 3, self._num_free_obs))

    def minimize(self, iterations: int) -> float:
        """Run Levenberg-Marquardt and return the cost before it."""
        damping = _FIRST_DAMPING
        first = cost = self.cost(self.chi2())
        for _ in range(iterations):
            system = self._linearize()
            T, points_m = self.T, self.points_m
            self._step(system, damping)
            new_cost = self.cost(self.chi2())
            if new_cost > cost:
                self.T, self.points_m = T, points_m
                self._project()
                damping = min(100 * damping, _MAX_DAMPING)
                continue
            done = cost - new_cost < _CONVERGED * cost
            cost, damping = new_cost, max(damping / 10, _MIN_DAMPING)
            if done:
                break
        return first

    def chi2(self) -> FloatArray:
        """Return (M,) squared normalised residuals; infinite behind a camera."""
        self._project()
        chi2: FloatArray = self._problem.inv_sigma2 * (self._residual**2).sum(0)
        chi2[self._behind] = np.inf
        return chi2

    def cost(self, chi2: FloatArray) -> float:
        """Return the Huber cost of the observations in use."""
        used = self._weight[0] > 0
        c, gate = chi2[used], self.gate[used]
        c = np.minimum(c, 1e6)
        return float(np.where(c <= gate, c, 2 * np.sqrt(gate * c) - gate).sum())

    def drop_outliers(self) -> None:
        """Leave out the observations beyond their gates from now on."""
        self._weight[:, self.chi2() > self.gate] = 0.0

    def _project(self) -> None:
        points = self.points_m[:, self._problem.point]
        for T, part in zip(self.T, self._slices, strict=True):
            self._x[:, part] = T[:3, :3] @ points[:, part] + T[:3, 3, None]
        self._behind = self._x[2] < MIN_DEPTH_M
        np.maximum(self._x[2], MIN_DEPTH_M, out=self._x[2])
        self._inv_z = project(self._camera, self._x, self._residual)
        np.subtract(self._measured, self._residual, out=self._residual)
        self._residual[2, self._no_depth] = 0.0

    def _linearize(self) -> _System:
        """Return the normal equations at the current state, whose residuals are up to date."""
        problem, n = self._problem, len(self.points_m[0])
        chi2 = self._problem.inv_sigma2 * (self._residual**2).sum(0)
        w = np.asarray(self._weight * np.sqrt(self.gate / np.maximum(chi2, self.gate)))
        w[:, self._behind] = 0.0
        point_jacobian(self._camera, self._x, self._inv_z, self._J_x)
        for T, part in zip(self.T, self._slices, strict=True):
            np.matmul(T[:3, :3].T, self._J_x[:, :, part], out=self._J_map[:, :, part])
        J, Jw = self._J_map, self._J_map * w[:, None]
        pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
        H_pp: FloatArray = np.stack(
            [np.bincount(problem.point, (J[:, a] * Jw[:, b]).sum(0), n) for a, b in pairs]
        )
        g_p: FloatArray = np.stack(
            [np.bincount(problem.point, (Jw[:, a] * self._residual).sum(0), n) for a in range(3)]
        )
        return self._add_cameras(Jw, w, H_pp, g_p)

    def _add_cameras(
        self, Jw: FloatArray, w: FloatArray, H_pp: FloatArray, g_p: FloatArray
    ) -> _System:
        problem, m, c = self._problem, self._num_free_obs, self._problem.num_free
        pose_jacobian(self._camera, self._x[:, :m], self._inv_z[:m], self._J_c)
        J_cw = self._J_c * w[:, :m]
        H_cc, g_c = np.empty((c, 6, 6)), np.empty((c, 6))
        H_cp = np.zeros((c, 6, 3, len(self.points_m[0])))
        cross = np.einsum('arm,rbm->abm', self._J_c, Jw[:, :, :m])
        for i, part in enumerate(self._slices[:c]):
            flat = J_cw[:, :, part].reshape(6, -1)
            H_cc[i] = flat @ self._J_c[:, :, part].reshape(6, -1).T
            g_c[i] = flat @ self._residual[:, part].ravel()
            H_cp[i][:, :, problem.point[part]] = cross[:, :, part]
        return _System(H_cc, g_c, H_pp, g_p, H_cp)

    def _step(self, system: _System, damping: float) -> None:
        """Solve for cameras (Schur complement), then points, and move."""
        c = len(system.H_cc)
        inverse = _inverse_symmetric(system.H_pp, damping)
        full = inverse[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        Y = np.empty_like(system.H_cp)
        for b in range(3):
            Y[:, :, b] = (system.H_cp * full[b]).sum(2)
        W = system.H_cp.reshape(6 * c, -1)
        S = -Y.reshape(6 * c, -1) @ W.T
        for i in range(c):
            block = slice(6 * i, 6 * i + 6)
            S[block, block] += system.H_cc[i] + damping * np.diag(np.diag(system.H_cc[i]))
        right = system.g_c.ravel() - Y.reshape(6 * c, -1) @ system.g_p.ravel()
        step = np.asarray(np.linalg.solve(S + _PIVOT * np.eye(6 * c), right), np.float64)
        left = system.g_p - (step @ W).reshape(3, -1)
        self.points_m = self.points_m + (full * left[None]).sum(1)
        moved = se3.exp(step.reshape(c, 6)) @ self.T[:c]
        self.T = np.concatenate([moved, self.T[c:]])


def _inverse_symmetric(H: FloatArray, damping: float) -> FloatArray:
    """Return (6, P) inverses of symmetric 3x3 matrices, damped on the diagonal."""
    xx, yy, zz = (H[[0, 3, 5]] * (1.0 + damping)) + _PIVOT
    xy, xz, yz = H[[1, 2, 4]]
    a = yy * zz - yz * yz
    b = xz * yz - xy * zz
    c = xy * yz - xz * yy
    inv = 1.0 / (xx * a + xy * b + xz * c)
    return np.stack(
        [a * inv, b * inv, c * inv, (xx * zz - xz * xz) * inv,
         (xy * xz - xx * yz) * inv, (xx * yy - xy * xy) * inv]
    )  # fmt: skip
