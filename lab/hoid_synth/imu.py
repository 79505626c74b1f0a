"""An IMU beside the rendered camera: rates and accelerations of its path, with errors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import NS_PER_S, FloatArray, IntArray
from hoid_synth.acting.camera_path import camera_poses
from hoid_synth.config import SceneConfig

R_CAMERA_IMU: FloatArray = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Rotation (3, 3) to the optical axes from those of the IMU: x forward, y left, z up."""
GYRO_BIAS_RADPS: FloatArray = np.array([0.012, -0.015, 0.01])
"""Bias (3,) of the gyro about the axes of the IMU, that of a common sensor."""
RATE_HZ = 200
_GRAVITY_MPS2: FloatArray = np.array([0.0, 0.0, 9.81])  # upwards, as an accelerometer at rest
_STEP_S = 2e-3  # chosen: of the differences; the tremor of the camera has 7 Hz at most
# Chosen, as Bosch's BMI055 at 200 Hz: 0.014 deg/s and 0.15 mg per root of Hz, times ten.
_RATE_NOISE_RADPS, _ACCELERATION_NOISE_MPS2 = 2e-3, 0.02


class ImuTrack(NamedTuple):
    """N samples along the axes of the IMU."""

    stamps_ns: IntArray  # (N,)
    rates_radps: FloatArray  # (N, 3)
    accelerations_mps2: FloatArray  # (N, 3), with gravity


def imu_track(config: SceneConfig) -> ImuTrack:
    """Return what an IMU measures from the first rendered frame to the last."""
    count = round(config.time_s(config.frames) * RATE_HZ)
    times_s = np.arange(count) / RATE_HZ
    before, now, after = (
        camera_poses(config, config.pace * (config.start_s + times_s + shift_s))
        for shift_s in (-_STEP_S, 0.0, _STEP_S)
    )
    rates = se3.log(se3.inverse(before) @ after)[:, :3] / (2 * _STEP_S)
    acceleration = (before - 2 * now + after)[:, :3, 3] / _STEP_S**2
    forces = np.einsum('nji,nj->ni', now[:, :3, :3], acceleration + _GRAVITY_MPS2)
    rng = np.random.default_rng([config.seed, 5])
    return ImuTrack(
        config.stamp_ns(0) + np.rint(times_s * NS_PER_S).astype(np.int64),
        rates @ R_CAMERA_IMU + GYRO_BIAS_RADPS + rng.normal(0, _RATE_NOISE_RADPS, rates.shape),
        forces @ R_CAMERA_IMU + rng.normal(0, _ACCELERATION_NOISE_MPS2, rates.shape),
    )
