"""Integrals of the samples of a gyro and an accelerometer between images."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hoid_common.values import S_PER_NS, FloatArray, IntArray
from rgbd_slam.inertial.sample_buffer import Samples

if TYPE_CHECKING:
    from rgbd_slam.optimize.preintegration import Preintegrated

_NOTHING: FloatArray = np.zeros(3)


def integrals(
    rates: Samples,
    at_ns: IntArray,
    bias_radps: FloatArray,
    forces: Samples | None = None,
    bias_mps2: FloatArray = _NOTHING,
) -> Preintegrated | None:
    """Return the integrals of the samples from the first of M times to each of them.

    Rates and forces are interpolated linearly. None if the samples do not cover the times.

    Args:
        rates: Samples of the gyro around these times.
        at_ns: (M,) increasing times by the clock of the IMU.
        bias_radps: (3,) bias of the gyro, along the axes of the IMU.
        forces: Samples of the accelerometer; None: integrate the rotation only.
        bias_mps2: (3,) bias of the accelerometer, along the axes of the IMU.
    """
    # Importing GTSAM takes more than 0.1 s, and a node without an IMU does not need it.
    from rgbd_slam.optimize.preintegration import preintegrated  # noqa: PLC0415

    first_ns, last_ns = int(at_ns[0]), int(at_ns[-1])
    sensors = [rates] if forces is None else [rates, forces]
    if not all(samples.cover(first_ns, last_ns) for samples in sensors):
        return None
    known_ns = np.concatenate([samples.stamps_ns for samples in sensors])
    is_within = (known_ns > first_ns) & (known_ns < last_ns)
    knots_ns: IntArray = np.unique(np.append(known_ns[is_within], at_ns))
    force = np.zeros((len(knots_ns) - 1, 3))
    if forces is not None:
        force = _means(forces, knots_ns) - bias_mps2
    rate = _means(rates, knots_ns) - bias_radps
    is_wanted = np.isin(knots_ns[1:], at_ns)
    return preintegrated(S_PER_NS * np.diff(knots_ns), rate, force, is_wanted)


def _means(samples: Samples, knots_ns: IntArray) -> FloatArray:
    """Return the mean values (N - 1, 3) between successive times (N,)."""
    known_s = S_PER_NS * (samples.stamps_ns - knots_ns[0])
    knots_s = S_PER_NS * (knots_ns - knots_ns[0])
    at_knots = np.stack([np.interp(knots_s, known_s, column) for column in samples.values.T], 1)
    return np.asarray(0.5 * (at_knots[1:] + at_knots[:-1]))
