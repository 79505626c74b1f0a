"""The features of an image for tracking: undistorted, with a virtual right column (decision 002).

A rectified stereo camera of baseline b would see a point of depth z and column u in its right
image at u_right = u - fx * b / z (Mur-Artal and Tardos, T-RO 2017, eq. 1).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hoid_common.errors import MessageError
from hoid_common.io.depth import is_reading
from hoid_common.values import (
    BoolArray,
    ByteArray,
    CameraModel,
    Features,
    Float32Array,
    FloatArray,
)
from hoid_native import StereoParams
from rgbd_slam.config.slam_config import CameraConfig


@dataclass(frozen=True)
class StereoCamera:
    """The camera model of the optimizers: a rectified stereo camera with a virtual baseline."""

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    baseline_px_m: float  # fx * b: disparity = baseline_px_m / depth_m
    disparity_noise_px: float  # constant part of the standard deviation of a disparity
    relative_noise: float  # proportional part, as a ratio to the disparity
    # u_min, v_min, u_max, v_max of the undistorted image
    bounds_px: tuple[float, float, float, float]
    pixel_noise: float = 1.0  # standard deviation of u and v in octave 0
    joint_noise: bool = False  # True: u, v and u_right share one noise and one robust kernel

    @classmethod
    def from_model(cls, camera: CameraModel, config: CameraConfig) -> StereoCamera:
        u = np.linspace(0, camera.width_px - 1, 9, dtype=np.float32)
        v = np.linspace(0, camera.height_px - 1, 9, dtype=np.float32)
        edge = np.concatenate(
            [np.stack([u, 0 * u + y], 1) for y in (0, camera.height_px - 1)]
            + [np.stack([0 * v + x, v], 1) for x in (0, camera.width_px - 1)]
        ).astype(np.float32)
        low, high = camera.undistort_px(edge).min(0), camera.undistort_px(edge).max(0)
        bounds = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
        return cls(
            camera.fx_px,
            camera.fy_px,
            camera.cx_px,
            camera.cy_px,
            camera.fx_px * config.baseline_m,
            config.disparity_noise_px,
            config.relative_depth_noise,
            bounds,
            joint_noise=config.joint_noise,
        )

    def with_noise(self, pixel: float, disparity: float) -> StereoCamera:
        """Return the camera with its pixel noise and its disparity noise multiplied by factors."""
        return replace(
            self,
            pixel_noise=pixel * self.pixel_noise,
            disparity_noise_px=disparity * self.disparity_noise_px,
            relative_noise=disparity * self.relative_noise,
        )

    @cached_property
    def lens(self) -> StereoParams:
        return StereoParams(
            self.fx_px,
            self.fy_px,
            self.cx_px,
            self.cy_px,
            self.baseline_px_m,
            self.disparity_noise_px,
            self.relative_noise,
            self.pixel_noise,
            self.joint_noise,
        )

    def measurement_px(
        self, uv_px: Float32Array | FloatArray, depth_m: Float32Array
    ) -> Float32Array:
        """Return (N, 3) u, v, u_right of undistorted pixels (N, 2); u_right is NaN at depth 0."""
        out = np.full((len(uv_px), 3), np.nan, np.float32)
        out[:, :2] = uv_px
        read = depth_m > 0
        out[read, 2] = uv_px[read, 0] - self.baseline_px_m / depth_m[read]
        return out

    def disparity_sigma_px(self, disparity_px: FloatArray) -> FloatArray:
        """Return the standard deviations (N,) in px of disparities (N,)."""
        sigma: FloatArray = np.hypot(self.disparity_noise_px, self.relative_noise * disparity_px)
        return sigma

    def project_rows(self, points_camera_m: FloatArray) -> FloatArray:
        """Return u, v, u_right (3, N) in px of points (3, N) in front of the camera.

        The coordinates are in contiguous rows, which is 3 times as fast as (N, 3).
        """
        x, y, z = points_camera_m
        inv_z = 1.0 / z
        u = x * inv_z * self.fx_px + self.cx_px
        v = y * inv_z * self.fy_px + self.cy_px
        return np.stack([u, v, inv_z * -self.baseline_px_m + u])

    def project(self, points_camera_m: FloatArray) -> FloatArray:
        """Return u, v, u_right (N, 3) in px of points (N, 3) in front of the camera."""
        return self.project_rows(points_camera_m.T).T

    def back_project(
        self, uv_px: Float32Array | FloatArray, depth_m: Float32Array | FloatArray
    ) -> FloatArray:
        """Return points (N, 3) in m in the camera frame, at pixels (N, >= 2) and depths (N,)."""
        z = depth_m.astype(np.float64)
        out = np.empty((len(z), 3))
        out[:, 0] = (uv_px[:, 0] - self.cx_px) / self.fx_px * z
        out[:, 1] = (uv_px[:, 1] - self.cy_px) / self.fy_px * z
        out[:, 2] = z
        return out


def to_camera(T_camera_map: FloatArray, points_m: FloatArray) -> FloatArray:
    """Return the points (3, N) in the camera frame for points (3, N) in the map frame."""
    return np.asarray(T_camera_map[:3, :3] @ points_m + T_camera_map[:3, 3, None])


def check_octaves(features: Features, num_octaves: int) -> None:
    """Raise MessageError if the octave of a feature is not below `num_octaves`."""
    highest = int(features.octave.max(initial=0))
    if highest >= num_octaves:
        raise MessageError(
            f'features.octave: {highest} is beyond the camera.num_octaves of SLAM, {num_octaves}: '
            'raise it, or publish features of fewer levels'
        )


@dataclass(frozen=True, eq=False)
class Frame:
    """The N undistorted features of an image."""

    stamp_ns: int
    measurement_px: Float32Array  # (N, 3) u, v, u_right; u_right is NaN without depth
    depth_m: Float32Array  # (N,); 0: no measurement
    octave: ByteArray  # (N,)
    angle_deg: Float32Array  # (N,) in [0, 360)
    descriptors: ByteArray  # (N, 32)
    may_seed: BoolArray  # (N,); False: may be matched, but may not create a map point

    @classmethod
    def from_features(cls, features: Features, model: CameraModel, camera: StereoCamera) -> Frame:
        depth_m = np.where(is_reading(features.depth_m), features.depth_m, np.float32(0))
        return cls(
            features.stamp_ns,
            camera.measurement_px(model.undistort_px(features.uv_px), depth_m),
            depth_m,
            features.octave,
            features.angle_deg,
            np.ascontiguousarray(features.descriptors),
            features.may_seed,
        )

    def __len__(self) -> int:
        return len(self.octave)

    @cached_property
    def has_depth(self) -> BoolArray:
        return self.depth_m > 0
