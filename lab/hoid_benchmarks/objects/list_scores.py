"""Comparison of the objects of a map with a list of what stands in the recording."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from hoid_benchmarks.objects.object_list import ListedObject
from hoid_common.values import Float32Array
from hoid_synth.truth import box_iou

# A found object is a listed one if the median overlap (IoU) of their boxes in the images is at
# least this: ScanNet's benchmark of 3-D boxes asks for 0.25 of the volume, which is 0.25^(2/3) of
# the area. An unsure object is treated as a crowd in COCO: a found object belongs to it if most of
# its box is inside.
MIN_IOU, _MIN_INSIDE = 0.4, 0.5


class Verdict(Enum):
    """What an object of a map is, by the list."""

    RIGHT = 'right'
    DOUBLE = 'double'  # a listed object has another one already
    WRONG = 'wrong'
    UNSURE = 'unsure'  # may be in the map, but need not


class FoundBoxes(NamedTuple):
    """An object of a map in the images of a list."""

    class_name: str
    # By stamp [ns]: (4,), zeros if the image does not show it. Images without a pose are missing.
    boxes_px: dict[int, Float32Array]


class ListScores(NamedTuple):
    """How the objects of a map fit a list."""

    verdicts: tuple[Verdict, ...]  # of each found object
    matches: tuple[str, ...]  # listed object that each found one overlaps most; '': none
    missed: tuple[str, ...]  # listed objects, the unsure ones left out, that were not found
    num_listed: int  # without the unsure ones

    def count(self, verdict: Verdict) -> int:
        """Return the number of found objects with a verdict."""
        return self.verdicts.count(verdict)


def score_list(found: Sequence[FoundBoxes], listed: Sequence[ListedObject]) -> ListScores:
    """Assign found objects to listed ones of their class, so that the overlap is largest."""
    sure = [item for item in listed if not item.is_unsure]
    places = np.array([[overlap(f, item) for item in sure] for f in found])
    places = places.reshape(len(found), len(sure))
    is_class = np.array([[f.class_name in item.classes for item in sure] for f in found], bool)
    fit = np.where(is_class.reshape(places.shape) & (places >= MIN_IOU), places, 0)
    rows, columns = linear_sum_assignment(fit, maximize=True)
    assigned = {r: c for r, c in zip(rows.tolist(), columns.tolist(), strict=True) if fit[r, c]}
    unsure = [item for item in listed if item.is_unsure]
    verdicts = [
        Verdict.RIGHT if k in assigned
        else Verdict.UNSURE if any(_is_in(item, other) for other in unsure)
        else Verdict.DOUBLE if fit[k].any()
        else Verdict.WRONG
        for k, item in enumerate(found)
    ]  # fmt: skip
    nearest = [
        sure[assigned.get(k, int(row.argmax()))].name if row.any() else ''
        for k, row in enumerate(places)
    ]
    missed = [item.name for k, item in enumerate(sure) if k not in assigned.values()]
    return ListScores(tuple(verdicts), tuple(nearest), tuple(missed), len(sure))


def overlap(found: FoundBoxes, listed: ListedObject) -> float:
    """Return the median IoU in the images of the listed object in which the map has a pose."""
    stamps_ns = sorted(listed.boxes_px.keys() & found.boxes_px.keys())
    if not stamps_ns:
        return 0.0
    pairs = [(found.boxes_px[k][None], listed.boxes_px[k][None]) for k in stamps_ns]
    return float(np.median([box_iou(*pair)[0, 0] for pair in pairs]))


def _is_in(found: FoundBoxes, unsure: ListedObject) -> bool:
    """Return whether most of a found object is in the boxes of an unsure one of its class."""
    shared_px = total_px = 0.0
    for stamp_ns in unsure.boxes_px.keys() & found.boxes_px.keys():
        box, around = found.boxes_px[stamp_ns], unsure.boxes_px[stamp_ns]
        sides = np.minimum(box[2:], around[2:]) - np.maximum(box[:2], around[:2])
        shared_px += np.maximum(sides, 0).prod()
        total_px += (box[2:] - box[:2]).prod()
    is_class = found.class_name in unsure.classes
    return is_class and shared_px >= _MIN_INSIDE * max(total_px, 1.0)
