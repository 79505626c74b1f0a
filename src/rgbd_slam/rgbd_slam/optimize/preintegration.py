"""Integration of IMU samples by GTSAM's preintegration."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import gtsam
import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray


class Preintegrated(NamedTuple):
    """Integrals of IMU samples from a start to M times, along the IMU's axes at the start.

    The specific force includes gravity. With position, velocity and gravity (upwards) at the
    start, the later position is position + velocity * time - 0.5 * gravity * time^2 + `moved_m`.
    """

    R_start_imu: FloatArray  # (M, 3, 3)
    velocity_mps: FloatArray  # (M, 3) integral of the specific force
    moved_m: FloatArray  # (M, 3) double integral of the specific force


def preintegrated(
    steps_s: FloatArray, rates_radps: FloatArray, forces_mps2: FloatArray, is_wanted: BoolArray
) -> Preintegrated:
    """Return the integrals at the start, and at the end of each of the M - 1 wanted steps of N.

    `PreintegratedImuMeasurements` (Forster et al., T-RO 2017) assumes that a force is constant in
    the IMU's frame at the start of its step. The forces (N, 3), measured in the middle of the
    steps, are therefore rotated to that frame. Rates (N, 3) and forces are without bias.
    """
    half_turns = np.zeros((len(steps_s), 6))
    half_turns[:, :3] = 0.5 * steps_s[:, None] * rates_radps
    forces_mps2 = np.einsum('nij,nj->ni', se3.exp(half_turns)[:, :3, :3], forces_mps2)
    measured = gtsam.PreintegratedImuMeasurements(_parameters(), gtsam.imuBias.ConstantBias())
    found = [(np.eye(3), np.zeros(3), np.zeros(3))]
    steps = zip(steps_s.tolist(), rates_radps, forces_mps2, is_wanted.tolist(), strict=True)
    for step_s, rate_radps, force_mps2, wanted in steps:
        measured.integrateMeasurement(force_mps2, rate_radps, step_s)
        if wanted:
            R_start_imu = measured.deltaRij().matrix()
            found.append((R_start_imu, measured.deltaVij(), measured.deltaPij()))
    return Preintegrated(*(np.array(part) for part in zip(*found, strict=True)))


@cache
def _parameters() -> gtsam.PreintegrationParams:
    return gtsam.PreintegrationParams.MakeSharedU(0.0)
