"""The part of a view that drags the pose: what would let all the rest fit better by leaving.

What moves slowly by itself fits the pose of all matches nearly as well as what rests, so that
residuals do not tell the two apart. Its equations do: without them the pose of the rest moves, and
the cost of the rest falls by more than noise explains.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import hoid_native
from hoid_common.values import BoolArray, Float32Array, FloatArray
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.projection import MIN_DEPTH_M
from rgbd_slam.optimize.pose_optimizer import GATES, PoseProblem

_MARGIN = np.array([0.02, 0.02, 0.05])[:, None]  # around a region, of directions and log depth


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
        problem: N matches.
        T_camera_map: (4, 4) pose that fits them.
        noise_scale: Variances in units of those measured so far.
    """
    part = hoid_native.heaviest_part(
        camera.lens,
        GATES,
        problem.points_m,
        problem.measured_px,
        problem.inv_sigma2,
        T_camera_map,
        noise_scale,
    )
    return Part(part.mask, Region(part.low[:, None], part.high[:, None]), part.gain)
