"""Matching along segments, against brute force."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hoid_native import Candidates, MatchThreshold, QueryConstraints, match_along_segments

ByteArray = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
RADIUS_PX = 2.0 * 1.2 ** np.arange(4, dtype=np.float64)
MOST = 60


def distance_px(pixel: FloatArray, segment: FloatArray) -> float:
    """Return the smallest distance of a pixel to a segment, by ever finer sampling."""
    low, high = 0.0, 1.0
    for _ in range(3):
        shares = np.linspace(low, high, 41)
        places = segment[:2] + shares[:, None] * (segment[2:] - segment[:2])
        distances = np.linalg.norm(places - pixel, axis=1)
        nearest = int(distances.argmin())  # the distance has one minimum only
        low, high = shares[max(nearest - 1, 0)], shares[min(nearest + 1, 40)]
    return float(distances.min())


def brute_force(
    segments: FloatArray,
    octaves: NDArray[np.int8],
    wanted: ByteArray,
    measured: NDArray[np.float32],
    octave: ByteArray,
    known: ByteArray,
    free: NDArray[np.bool_],
) -> set[tuple[int, int]]:
    """Return the pairs by brute force, without a ratio test."""
    wins: dict[int, list[tuple[int, int]]] = {}
    for q, segment in enumerate(segments):
        near = [
            (int(np.bitwise_count(wanted[q] ^ known[k]).sum()), k)
            for k in range(len(octave))
            if free[k]
            and octaves[q] <= octave[k] <= min(octaves[q] + 1, 3)
            and distance_px(measured[k, :2].astype(float), segment) < RADIUS_PX[octave[k]]
        ]
        if near and min(near)[0] <= MOST:
            wins.setdefault(min(near)[1], []).append((min(near)[0], q))
    return {(min(queries)[1], k) for k, queries in wins.items()}


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6))
def test_matches_equal_brute_force(seed: int) -> None:
    rng = np.random.default_rng(seed)
    num_q, num_k = int(rng.integers(1, 12)), int(rng.integers(1, 30))
    measured = rng.uniform(0, 200, (num_k, 3)).astype(np.float32)
    known = rng.integers(0, 256, (num_k, 32)).astype(np.uint8)
    source = rng.integers(0, num_k, num_q)
    wanted = known[source] ^ (rng.random((num_q, 32)) < 0.2).astype(np.uint8)
    segments = np.concatenate([measured[source, :2]] * 2, 1) + rng.normal(0, 20, (num_q, 4))
    segments[::3, 2:] = 2 * measured[source, :2][::3] - segments[::3, :2]  # through the pixel
    octave = rng.integers(0, 4, num_k).astype(np.uint8)
    low = rng.integers(0, 4, num_q).astype(np.int8)
    free = rng.random(num_k) < 0.8
    found = match_along_segments(
        segments,
        RADIUS_PX,
        QueryConstraints(low, np.minimum(low + 1, 3).astype(np.int8), wanted),
        Candidates(measured, octave, known, free),
        MatchThreshold(MOST, 1.0),
    )
    mine = set(zip(found.q.tolist(), found.k.tolist(), strict=True))
    assert mine == brute_force(segments, low, wanted, measured, octave, known, free)


def test_a_segment_that_is_unknown_matches_nothing() -> None:
    nothing = match_along_segments(
        np.full((1, 4), np.nan),
        RADIUS_PX,
        QueryConstraints(np.zeros(1, np.int8), np.ones(1, np.int8), np.zeros((1, 32), np.uint8)),
        Candidates(np.zeros((1, 3), np.float32), np.zeros(1, np.uint8), np.zeros((1, 32), 'u1')),
        MatchThreshold(MOST, 1.0),
    )
    assert len(nothing.q) == 0


def test_rivals_of_one_octave_leave_a_query_unmatched() -> None:
    known = np.zeros((2, 32), np.uint8)
    known[1, 0] = 1
    measured = np.array([[20, 50, np.nan], [80, 50, np.nan]], np.float32)
    octaves, like = (np.zeros(1, np.int8), np.ones(1, np.int8)), np.full((1, 32), 1, np.uint8)
    pairs = [
        match_along_segments(
            np.array([[0.0, 50, 100, 50]]),
            RADIUS_PX,
            QueryConstraints(*octaves, like),
            Candidates(measured, np.zeros(2, np.uint8), known),
            MatchThreshold(MOST, ratio),
        )
        for ratio in (1.0, 0.9)
    ]
    assert [pair.k.tolist() for pair in pairs] == [[1], []]
