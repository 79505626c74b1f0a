"""The part of a view that drags the pose: what would let all the rest fit better by leaving.

What moves slowly by itself fits the pose of all matches nearly as well as what rests, so that
residuals do not tell the two apart. Its equations do: without them the pose of the rest moves, and
the cost of the rest falls by more than noise explains. Parts are the cells of a k-d tree over
direction and depth (Bentley, CACM 1975), as what moves is in one place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import BoolArray, Float32Array, FloatArray, IntArray
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.projection import MIN_DEPTH_M, to_camera
from rgbd_slam.optimize.pose_optimizer import CHI2_MONO, PoseProblem

_CHI2_DISPARITY = 3.841  # 95 % of one degree of freedom
_LEVELS = 4  # of the tree: parts are a sixteenth of the matches,
_LARGEST = 2  # and at most a quarter, at this level
_MARGIN = np.array([0.02, 0.02, 0.05])[:, None]  # around a region, of directions and log depth
_DAMPING = 1e-6  # of a motion that the rest tells nothing of


class Region(NamedTuple):
    """A box of directions x / z and y / z, and of the logarithm of depth, in the camera."""

    low: FloatArray  # (3, 1)
    high: FloatArray

    def holds(
        self, camera: StereoCamera, measured_px: Float32Array, depth_m: Float32Array
    ) -> BoolArray:
        """Return (N,) which features lie in it or near; without depth, by their direction."""
        u, v = measured_px[:, :2].T
        x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
        at = np.stack([x, y, np.log(np.maximum(depth_m, MIN_DEPTH_M))])
        inside = (self.low - _MARGIN <= at) & (at <= self.high + _MARGIN)
        inside[2] |= depth_m <= 0
        return np.asarray(inside.all(0))


class Part(NamedTuple):
    """Matches in one place, and what it would mean to leave them out."""

    mask: BoolArray  # (N,)
    region: Region
    gain: float  # by how much the cost of the rest would fall, to first order


def heaviest_part(
    camera: StereoCamera, problem: PoseProblem, T_camera_map: FloatArray, noise_scale: float
) -> Part:
    """Return the part without which the rest of the N matches would fit best.

    Args:
        camera: With the noise measured so far.
        problem: N matches, more than there are parts.
        T_camera_map: (4, 4) pose that fits them.
        noise_scale: Variances in units of those measured so far.
    """
    x = to_camera(T_camera_map, problem.points_m.T)
    x[2] = np.maximum(x[2], MIN_DEPTH_M)
    place = np.stack([x[0] / x[2], x[1] / x[2], np.log(x[2])], 1)
    cells, is_first = _cells(place)
    rows = _rows(camera, problem, x, noise_scale)[cells] * is_first[..., None, None]
    rows = rows.reshape(len(cells), -1, 7)
    sums = np.stack([A.T @ A for A in rows])
    members, nodes, parts = cells, [], []
    for _ in range(_LEVELS - _LARGEST + 1):
        nodes.append(sums)
        parts += list(members)
        sums, members = sums[::2] + sums[1::2], members.reshape(len(members) // 2, -1)
    rest = sums.sum(0) - np.concatenate(nodes)
    H, g = rest[:, :6, :6] + _DAMPING * np.eye(6), rest[:, :6, 6:]
    gain = (g * np.linalg.solve(H, g)).sum((1, 2))
    most = int(np.argmax(gain))
    mask = np.zeros(len(problem), np.bool_)
    mask[parts[most]] = True
    inside = place[mask].T
    region = Region(inside.min(1, keepdims=True), inside.max(1, keepdims=True))
    return Part(mask, region, float(gain[most]))


def _cells(place: FloatArray) -> tuple[IntArray, BoolArray]:
    """Return (C, M) rows of (N, 3) places, halved where they vary most, siblings in a row.

    Some come again where N is no multiple of C; the (C, M) mask tells where they come first.
    """
    count, num = len(place), 2**_LEVELS
    cells = np.arange(-(-count // num) * num)[None]
    place = np.resize(place, (cells.size, 3)).T.copy()
    for _ in range(_LEVELS):
        at = place[:, cells]
        axis = at.var(2).argmax(0)
        c = np.arange(len(cells))
        order = at[axis, c].argsort(1, kind='stable')
        cells = cells[c[:, None], order].reshape(2 * len(cells), -1)
    return cells % count, cells < count


def _rows(
    camera: StereoCamera, problem: PoseProblem, x: FloatArray, noise_scale: float
) -> FloatArray:
    """Return (N, 3, 7) weighted derivatives of u, v and disparity by a left twist, and errors."""
    error = problem.measured_px.T - camera.project_rows(x)
    error[2] = error[0] - error[2]
    sigma_px = camera.disparity_sigma_px(problem.measured_px[:, 0] - problem.measured_px[:, 2])
    pixel = problem.inv_sigma2 / (camera.pixel_noise**2 * noise_scale)
    depth = 1 / (sigma_px**2 * noise_scale)
    pixel[pixel * (error[0] ** 2 + error[1] ** 2) > CHI2_MONO] = 0
    depth[~(depth * error[2] ** 2 <= _CHI2_DISPARITY)] = 0  # none without a reading either
    inv_z = 1 / x[2]
    out = np.zeros((3, 7, x.shape[1]))
    by_point, by_turn = out[:, 3:6], out[:, :3]
    by_point[0, 0], by_point[1, 1] = camera.fx_px * inv_z, camera.fy_px * inv_z
    by_point[:2, 2] = -np.stack([camera.fx_px * x[0], camera.fy_px * x[1]]) * inv_z**2
    by_point[2, 2] = -camera.baseline_px_m * inv_z**2
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        by_turn[:, a] = x[b] * by_point[:, c] - x[c] * by_point[:, b]
    out[:, 6] = np.nan_to_num(error)
    out *= np.sqrt(np.stack([pixel, pixel, depth]))[:, None]
    return np.ascontiguousarray(out.transpose(2, 0, 1))
