"""Parts of a route that show a place again, by the true poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from hoid_common.values import NS_PER_S, BoolArray, FloatArray, Trajectory

MIN_ELAPSED_S = 30.0
"""Time after which a view is seen again and not still."""
_SAMPLE_S = 0.5
# Views that share most of their surface: the field of view is 60 degrees.
_NEAR_M, _NEAR_DEG = 1.0, 20.0
_GAP_S = 5.0  # between two parts of one revisit
_MIN_S = 2.0  # shorter ones, such as while turning, may pass without a keyframe


class Revisit(NamedTuple):
    """A time in which the camera sees what it saw long before."""

    first_s: float
    last_s: float
    seen_s: float  # the first time at which its first view was seen


def revisits(truth: Trajectory) -> list[Revisit]:
    """Return the times in which a route shows known views."""
    stamps_s = truth.stamps_ns / NS_PER_S
    step = max(round(_SAMPLE_S / float(np.median(np.diff(stamps_s)))), 1)
    stamps_s, T = stamps_s[::step], truth.T_world_camera[::step]
    seen_s = _first_seen_s(stamps_s, T)
    again = np.flatnonzero(np.isfinite(seen_s))
    if len(again) == 0:
        return []
    parts = np.split(again, np.flatnonzero(np.diff(stamps_s[again]) > _GAP_S) + 1)
    found = [
        Revisit(float(stamps_s[part[0]]), float(stamps_s[part[-1]]), float(seen_s[part[0]]))
        for part in parts
    ]
    return [revisit for revisit in found if revisit.last_s - revisit.first_s >= _MIN_S]


def _first_seen_s(stamps_s: FloatArray, T_world_camera: FloatArray) -> FloatArray:
    """Return when (N,) each view was seen first, long before; infinity for new views."""
    position_m, ahead = T_world_camera[:, :3, 3], T_world_camera[:, :3, 2]
    tree = cKDTree(position_m)
    out = np.full(len(stamps_s), np.inf)
    for n, near in enumerate(tree.query_ball_point(position_m, _NEAR_M)):
        rows = np.array(near)
        is_same: BoolArray = stamps_s[rows] < stamps_s[n] - MIN_ELAPSED_S
        is_same &= ahead[rows] @ ahead[n] > np.cos(np.deg2rad(_NEAR_DEG))
        if is_same.any():
            out[n] = stamps_s[rows[is_same]].min()
    return out
