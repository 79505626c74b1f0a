"""Which features show which map points: by where these are expected, and by descriptors alone."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

import hoid_native
from hoid_common.values import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from hoid_native import Candidates, MatchThreshold, QueryConstraints
from rgbd_slam.model.frame import Frame

MAX_HAMMING = 256
_NEAREST = 2  # candidates of a query: the best and its rival
_ROTATION_BINS = 30
_ROTATION_PEAKS = 3
_LANES = np.uint32(0x00FF00FF)


class Queries(NamedTuple):
    """What is looked for, as parallel arrays over Q map points."""

    projection_px: FloatArray  # (3, Q) u, v, u_right where each is expected
    radius_px: FloatArray  # (Q,)
    min_octave: NDArray[np.int8]  # (Q,)
    max_octave: NDArray[np.int8]  # (Q,)
    descriptors: ByteArray  # (Q, 32)


class Matches(NamedTuple):
    """Parallel arrays (M,): query q is feature k; no q and no k occurs twice."""

    q: IntArray
    k: IntArray
    distance: IntArray  # Hamming


def hamming(a: ByteArray, b: ByteArray) -> IntArray:
    """Return (M,) distances between rows of two (M, 32) arrays.

    Counts of the four words are added in 16-bit lanes: numpy's sum over a short axis is slow.
    """
    counts = np.bitwise_count(_words(a) ^ _words(b)).view(np.uint32).ravel()
    pairs = (counts & _LANES) + ((counts >> np.uint32(8)) & _LANES)
    return np.asarray((pairs & np.uint32(0xFFFF)) + (pairs >> np.uint32(16)), np.int64)


def _words(descriptors: ByteArray) -> NDArray[np.uint64]:
    return np.ascontiguousarray(descriptors).view(np.uint64)


def match_by_projection(
    queries: Queries,
    frame: Frame,
    max_distance: int,
    ratio: float,
    free: BoolArray | None = None,
) -> Matches:
    """Return the best feature of each query, one to one, among the `free` (N,) features.

    A candidate lies in the window and the octave range, and its right coordinate agrees when it
    has one. A best candidate of the same octave as the second best must beat it by `ratio`
    (1.0: no such test).
    """
    pairs = hoid_native.match_by_projection(
        queries.projection_px,
        queries.radius_px,
        QueryConstraints(queries.min_octave, queries.max_octave, queries.descriptors),
        Candidates(frame.measurement_px, frame.octave, frame.descriptors, free),
        MatchThreshold(max_distance, ratio),
    )
    return Matches(*(part.astype(np.int64) for part in pairs))


def match_by_descriptor(
    descriptors: ByteArray, frame: Frame, max_distance: int, ratio: float
) -> Matches:
    """Return the features of a frame most like (Q, 32) descriptors, wherever they are."""
    if min(len(descriptors), len(frame)) < _NEAREST:
        return Matches(*np.empty((3, 0), np.int64))
    distance, nearest = cv2.batchDistance(
        descriptors, frame.descriptors, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=_NEAREST
    )
    q = np.repeat(np.arange(len(descriptors)), _NEAREST)
    k, apart = nearest.ravel().astype(np.int64), distance.ravel().astype(np.int64)
    return best_matches(q, k, apart, frame.octave, max_distance, ratio)


def best_matches(
    q: IntArray,
    k: IntArray,
    distance: IntArray,
    octave: ByteArray,
    max_distance: int,
    ratio: float,
) -> Matches:
    """Return one-to-one matches of candidate pairs: best of each query, then of each feature."""
    order = np.argsort(q * (2 * MAX_HAMMING) + distance, kind='stable')
    q, k, distance = q[order], k[order], distance[order]
    first = np.flatnonzero(np.r_[True, q[1:] != q[:-1]]) if len(q) else order
    good = distance[first] <= max_distance
    if ratio < 1.0 and len(q) > 1:
        second = np.minimum(first + 1, len(q) - 1)
        rivals = (q[second] == q[first]) & (second != first)
        rivals &= octave[k[second]] == octave[k[first]]
        good &= ~(rivals & (distance[first] > ratio * distance[second]))
    q, k, distance = q[first[good]], k[first[good]], distance[first[good]]
    order = np.argsort(k * (2 * MAX_HAMMING) + distance, kind='stable')
    k_sorted = k[order]
    won = order[np.r_[True, k_sorted[1:] != k_sorted[:-1]]] if len(k) else order
    won = np.sort(won)
    return Matches(q[won], k[won], distance[won])


def rotation_consistent(angle_from_deg: Float32Array, angle_to_deg: Float32Array) -> BoolArray:
    """Return which of (M,) matches turn by an angle that many others turn by, too.

    ORB-SLAM's check: a histogram of 30 bins, of which the three fullest count, unless the second
    or third holds less than a tenth of the first.
    """
    turn = np.mod(angle_from_deg - angle_to_deg, 360.0)
    bins = np.mod(np.rint(turn * (_ROTATION_BINS / 360.0)).astype(np.int64), _ROTATION_BINS)
    votes = np.bincount(bins, minlength=_ROTATION_BINS)
    peaks = np.argsort(-votes, kind='stable')[:_ROTATION_PEAKS]
    accepted = np.zeros(_ROTATION_BINS, np.bool_)
    accepted[peaks[votes[peaks] >= 0.1 * votes[peaks[0]]]] = True
    return np.asarray(accepted[bins])
