"""Drift over recordings that are too short for an error over a second."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.values import FloatArray, IntArray, Trajectory


def end_drift_m(estimate: Trajectory, truth: Trajectory) -> float:
    """Return how far the last pose is from the truth, seen from the first one.

    Truth is interpolated to the stamps of the estimate: a nearest pose 10 ms away is centimetres
    away in a hand.

    Raises:
        InputError: Less than two poses of the estimate lie within the truth's time.
    """
    stamps = estimate.stamps_ns
    within = (stamps >= truth.stamps_ns[0]) & (stamps <= truth.stamps_ns[-1])
    if np.count_nonzero(within) < 2:
        raise InputError(
            f'estimate and truth share {np.count_nonzero(within)} poses, 2 are needed'
        )
    ends = np.flatnonzero(within)[[0, -1]]
    first, last = estimate.T_world_camera[ends]
    first_true, last_true = interpolated(truth, stamps[ends])
    motion_true = se3.inverse(first_true) @ last_true
    apart = se3.inverse(motion_true) @ se3.inverse(first) @ last
    return float(np.linalg.norm(apart[:3, 3]))


def interpolated(trajectory: Trajectory, stamps_ns: IntArray) -> FloatArray:
    """Return (N, 4, 4) poses at stamps within a trajectory's time, on screws between its own."""
    known_ns = trajectory.stamps_ns
    after = np.clip(np.searchsorted(known_ns, stamps_ns), 1, len(known_ns) - 1)
    T = trajectory.T_world_camera[after - 1]
    span_ns = np.maximum(known_ns[after] - known_ns[after - 1], 1)
    share = (stamps_ns - known_ns[after - 1]) / span_ns
    step = se3.log(se3.inverse(T) @ trajectory.T_world_camera[after])
    return T @ se3.exp(share[:, None] * step)
