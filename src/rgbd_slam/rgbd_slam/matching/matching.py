"""Matching of map points with features, near predicted projections or by descriptors alone."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

import hoid_native
from hoid_common.values import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from hoid_native import Candidates, MatchThreshold, QueryConstraints
from rgbd_slam.model.frame import Frame

_NUM_NEAREST = 2  # best and second best candidate of a query, for the ratio test
# Number of bins of the histogram of feature rotations. A match is kept if its bin is one of the
# three fullest and has at least this ratio of the matches of the fullest bin (ORB-SLAM3,
# ORBmatcher.cc, HISTO_LENGTH and ComputeThreeMaxima).
_ROTATION_BINS = 30
_ROTATION_PEAKS = 3
_MIN_PEAK_SHARE = 0.1
_LANES = np.uint32(0x00FF00FF)  # mask of every other byte: bit counts are added in 16-bit lanes


class Queries(NamedTuple):
    """Q landmarks (map points or depth measurements) to search for in a frame."""

    projection_px: FloatArray  # (3, Q) predicted u, v, u_right
    radius_px: FloatArray  # (Q,) half sides of the square search windows
    min_octave: NDArray[np.int8]  # (Q,) lowest octave of a matching feature
    max_octave: NDArray[np.int8]  # (Q,) highest octave of a matching feature
    descriptors: ByteArray  # (Q, 32)


class Matches(NamedTuple):
    """M one-to-one matches of queries with features."""

    q: IntArray  # (M,) indices of queries
    k: IntArray  # (M,) indices of features
    distance: IntArray  # (M,) Hamming distances of the descriptors, in bits

    def select(self, keep: BoolArray) -> Matches:
        return Matches._make(column[keep] for column in self)


def hamming(a: ByteArray, b: ByteArray) -> IntArray:
    """Return the Hamming distances (M,) in bits between the rows of two arrays (M, 32).

    The bit counts of four words are added in 16-bit lanes, because NumPy is slow over short axes.
    """
    counts = np.bitwise_count(_words(a) ^ _words(b)).view(np.uint32).ravel()
    pairs = (counts & _LANES) + ((counts >> np.uint32(8)) & _LANES)
    return np.asarray((pairs & np.uint32(0xFFFF)) + (pairs >> np.uint32(16)), np.int64)


def _words(descriptors: ByteArray) -> NDArray[np.uint64]:
    return np.ascontiguousarray(descriptors).view(np.uint64)


def match_by_projection(
    queries: Queries, frame: Frame, max_distance: int, ratio: float, free: BoolArray | None = None
) -> Matches:
    """Return one-to-one matches of queries with features near their projections.

    A candidate lies in the search window and in the octave range of a query; if it has depth, its
    u_right lies in the window too. The best distance is at most `max_distance` bits and, if the
    two best candidates have the same octave, at most `ratio` times the second best (1.0: no test).
    `free` (N,) is the mask of features that may be matched.
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
    """Return one-to-one matches of (Q, 32) descriptors with features anywhere in a frame.

    The last two arguments are as in `match_by_projection`. With fewer than two descriptors or
    features, there are no matches.
    """
    if min(len(descriptors), len(frame)) < _NUM_NEAREST:
        return Matches(*np.empty((3, 0), np.int64))
    distance, nearest = cv2.batchDistance(
        descriptors, frame.descriptors, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=_NUM_NEAREST
    )
    is_good = distance[:, 0] <= max_distance
    if ratio < 1.0:
        is_compared = frame.octave[nearest[:, 0]] == frame.octave[nearest[:, 1]]
        is_good &= ~(is_compared & (distance[:, 0] > ratio * distance[:, 1]))
    q = np.flatnonzero(is_good)
    k, apart = (column[q, 0].astype(np.int64) for column in (nearest, distance))
    order = np.lexsort((apart, k))  # the best match of each feature first
    best = np.sort(order[np.unique(k[order], return_index=True)[1]])
    return Matches(q[best], k[best], apart[best])


def rotation_consistent(angle_from_deg: Float32Array, angle_to_deg: Float32Array) -> BoolArray:
    """Return the mask (M,) of matches whose features are rotated by one of the common angles.

    This is the orientation check of ORB-SLAM3 (ORBmatcher.cc): the three highest bins of a
    histogram of angles are accepted, unless they are less than a tenth as high as the highest.
    """
    turn = np.mod(angle_from_deg - angle_to_deg, 360.0)
    bins = np.mod(np.rint(turn * (_ROTATION_BINS / 360.0)).astype(np.int64), _ROTATION_BINS)
    votes = np.bincount(bins, minlength=_ROTATION_BINS)
    peaks = np.argsort(-votes, kind='stable')[:_ROTATION_PEAKS]
    accepted = np.zeros(_ROTATION_BINS, np.bool_)
    accepted[peaks[votes[peaks] >= _MIN_PEAK_SHARE * votes[peaks[0]]]] = True
    return np.asarray(accepted[bins])
