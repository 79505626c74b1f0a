"""Non-maximum suppression, compared with its definition."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hoid_common.values import Float32Array, IntArray
from hoid_detector.model.decoders import MAX_CANDIDATES, nms


def iou(a: Float32Array, b: Float32Array) -> float:
    low, high = np.maximum(a[:2], b[:2]), np.minimum(a[2:], b[2:])
    shared = np.prod(np.maximum(high - low, 0))
    return float(shared / (np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - shared))


def by_definition(
    boxes: Float32Array, scores: Float32Array, class_ids: IntArray, limit: float
) -> list[int]:
    kept: list[int] = []
    for i in np.argsort(-scores, kind='stable').tolist():
        if all(class_ids[i] != class_ids[k] or iou(boxes[i], boxes[k]) <= limit for k in kept):
            kept.append(i)
    return kept


@given(st.integers(0, 40), st.integers(0, 10**6), st.sampled_from([0.2, 0.45, 0.7]))
def test_the_same_boxes_are_kept_as_by_definition(count: int, seed: int, limit: float) -> None:
    rng = np.random.default_rng(seed)
    corner = rng.uniform(0, 40, (count, 2))  # no overlap is exactly at a limit
    size = rng.uniform(10, 30, (count, 2))
    boxes = np.hstack([corner, corner + size]).astype(np.float32)
    scores = (rng.permutation(count) / 50).astype(np.float32)
    class_ids = rng.integers(0, 3, count)
    assert nms(boxes, scores, class_ids, limit).tolist() == by_definition(
        boxes, scores, class_ids, limit
    )


def test_only_the_strongest_candidates_are_considered() -> None:
    count = 5 * MAX_CANDIDATES
    left = np.arange(count, dtype=np.float32) * 20
    boxes = np.stack([left, left * 0, left + 10, left * 0 + 10], axis=1)
    scores = np.linspace(0, 1, count, dtype=np.float32)
    kept = nms(boxes, scores, np.zeros(count, np.int64), 0.5)
    np.testing.assert_array_equal(kept, np.arange(count)[::-1][:MAX_CANDIDATES])
