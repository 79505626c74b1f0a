"""End drift of recordings that are too short for the relative pose error over a second."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.values import FloatArray, IntArray, Trajectory


def end_drift_m(estimate: Trajectory, truth: Trajectory) -> float:
    """Return the translation error [m] of the last pose relative to the first one.

    The ground truth is interpolated to the stamps of the estimate, because a hand-held camera
    moves by up to a centimeter in 10 ms.

    Raises:
        InputError: Fewer than two poses lie within the time of the ground truth.
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
    """Return (N, 4, 4) poses at stamps, interpolated by the screw motion between neighbors."""
    known_ns = trajectory.stamps_ns
    after = np.clip(np.searchsorted(known_ns, stamps_ns), 1, len(known_ns) - 1)
    T = trajectory.T_world_camera[after - 1]
    span_ns = np.maximum(known_ns[after] - known_ns[after - 1], 1)
    share = (stamps_ns - known_ns[after - 1]) / span_ns
    step = se3.log(se3.inverse(T) @ trajectory.T_world_camera[after])
    return T @ se3.exp(share[:, None] * step)
