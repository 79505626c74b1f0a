"""Comparison of the objects of a map with the true objects of a rendered room."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hoid_benchmarks.rooms.object_truth import TrueObject
from hoid_benchmarks.rooms.placed_box import PlacedBox
from hoid_common.values import FloatArray

# A found object is compared with the true one that it overlaps most, or whose center is near.
_MIN_IOU, _NEAR_M = 0.1, 0.25
_SMALL_M = 0.6  # largest side of a small object


class FoundObject(NamedTuple):
    """An object of a map."""

    class_name: str
    box: PlacedBox


class ObjectScores(NamedTuple):
    """Counts and errors of the objects of one or more rooms."""

    num_expected: int
    num_recalled: int  # of the expected ones
    num_found: int  # objects of the map
    num_right: int  # found objects that are the first one of a true object
    num_double: int  # found objects beyond the first one of a true object
    num_false: int  # found objects without a true object
    num_class_right: int  # of `num_right`
    center_m: FloatArray  # (M,) errors of the center of the whole object
    small_center_m: FloatArray  # (S,) the same of small objects
    seen_center_m: FloatArray  # (M,) errors of the center of the seen part
    size_m: FloatArray  # (M,) mean error per axis of the size of the seen part
    # (L,) relative errors of the footprint's area of large objects, by the whole or the seen part,
    # whichever is nearer.
    area: FloatArray


def score_objects(found: Sequence[FoundObject], true: Sequence[TrueObject]) -> ObjectScores:
    """Return the scores of the objects of a map; each is compared with one true object."""
    best: dict[int, tuple[float, int]] = {}
    num_double = num_false = 0
    for f, item in enumerate(found):
        ratings = [rating(item, other) for other in true]
        t = int(np.argmax(ratings)) if ratings else -1
        if t < 0 or ratings[t] <= 0:
            num_false += 1
        elif t in best:
            num_double += 1
            best[t] = max(best[t], (ratings[t], f))
        else:
            best[t] = ratings[t], f
    pairs = [(found[f], true[t]) for t, (_, f) in best.items()]
    small = [max(t.whole.size_m) <= _SMALL_M for _, t in pairs]
    whole = _norms([f.box.center_m - t.whole.center_m for f, t in pairs])
    seen = _norms([f.box.center_m - t.seen.center_m for f, t in pairs])
    areas = [
        min(abs(f.box.area_m2 / box.area_m2 - 1) for box in (t.whole, t.seen))
        for (f, t), is_small in zip(pairs, small, strict=True)
        if not is_small
    ]
    return ObjectScores(
        sum(t.is_expected for t in true),
        sum(true[t].is_expected for t in best),
        len(found),
        len(best),
        num_double,
        num_false,
        sum(f.class_name == t.class_name for f, t in pairs),
        whole,
        whole[np.array(small, bool)],
        seen,
        np.array([t.seen.size_error_m(f.box) for f, t in pairs]),
        np.array(areas),
    )


def rating(found: FoundObject, true: TrueObject) -> float:
    """Return how well an object fits a true one; 0: it does not."""
    best = 0.0
    for box in (true.whole, true.seen):
        iou = found.box.iou(box)
        gap_m = float(np.linalg.norm(found.box.center_m - box.center_m))
        near = (1 - gap_m / _NEAR_M) * _MIN_IOU
        best = max(best, iou if iou >= _MIN_IOU else max(near, 0.0))
    return best


def _norms(offsets: Sequence[FloatArray]) -> FloatArray:
    return np.asarray(np.linalg.norm(np.array(offsets).reshape(-1, 3), axis=1))
