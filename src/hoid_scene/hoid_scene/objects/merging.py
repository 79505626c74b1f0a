"""Merges objects of the map that represent the same thing at one place."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray
from hoid_scene.objects.evidence import is_confusable
from hoid_scene.objects.mapped_object import MappedObject
from hoid_scene.objects.segmentation import BARE, BoxPx, Segment

# Numbers without a source were not tuned. Two boxes that share more than this ratio of the smaller
# one may show the same object.
_DOUBLE_RATIO = 0.7
_MARGIN_M = 0.04  # by which an object's box is enlarged on each side
# Two objects of a class are the same if the box of each has more than this ratio of the other:
# things are not inside each other. In 28 maps of rendered rooms, the one pair that was the same
# object had 0.81, and pairs of different objects had at most 0.60.
_INSIDE_RATIO = 0.7
_MERGE_RATIO = 0.5  # of one object's voxels in the box of the other, from which on they are merged
_MERGE_OTHER_RATIO = 0.8  # the same for classes that detectors do not confuse
_SUPPORT_RATIO = 2.5  # ratio of radii from which on the smaller object may lie on the larger one
_PART_RATIO = 0.8  # of an object's voxels near the surface of a larger one that it is a part of
_CHAIR, _CHAIR_M = 'chair', 0.65  # largest width and depth of a usual chair; chosen


class Merging:
    """Merges objects that overlap, unless an image has shown both beside each other.

    Attributes:
        apart: Pairs of ids, the smaller one first, that one image showed as two objects.
    """

    def __init__(self) -> None:
        self.apart: set[tuple[int, int]] = set()

    def note_apart(self, seen: Sequence[tuple[MappedObject, Segment]]) -> None:
        for (first, one), (second, other) in combinations(seen, 2):
            pair = _pair(first.object_id, second.object_id)
            if pair not in self.apart and not _overlap_much(one.box_px, other.box_px):
                self.apart.add(pair)

    def merged(self, objects: Sequence[MappedObject]) -> list[MappedObject]:
        """Return the objects after merging; of each pair, the object seen more often is kept.

        It gets the number of the older object.
        """
        by_size = sorted(objects, key=lambda item: -item.evidence.num_sightings)
        gone: set[int] = set()
        for i, j in np.argwhere(np.triu(_touching(by_size), 1)).tolist():
            first, second = by_size[i], by_size[j]
            if first.object_id in gone or second.object_id in gone:
                continue
            if self._are_one(first, second):
                if second.is_older_than(first):
                    first.object_id, second.object_id = second.object_id, first.object_id
                first.absorb(second)
                gone.add(second.object_id)
                self._rename(second.object_id, first.object_id)
        return [item for item in objects if item.object_id not in gone]

    def _rename(self, old: int, new: int) -> None:
        renamed = {_pair(*(new if i == old else i for i in pair)) for pair in self.apart}
        self.apart = {pair for pair in renamed if pair[0] != pair[1]}

    def _are_one(self, first: MappedObject, second: MappedObject) -> bool:
        if not (first.is_present and second.is_present and first.map_id == second.map_id):
            return False
        if _pair(first.object_id, second.object_id) in self.apart:
            return are_inside_each_other(first, second)
        is_alike = is_confusable(first.class_name, second.class_name)
        small, large = sorted((first, second), key=lambda item: item.surface.radius_m())
        if not is_alike and small.class_name in BARE and large.class_name not in BARE:
            return False  # such as a screen and the desk in whose box it stands
        if not is_alike and large.surface.radius_m() > _SUPPORT_RATIO * small.surface.radius_m():
            is_part = large.class_name in BARE
            near = large.surface.ratio_near(small.surface.solid_points_map_m()) if is_part else 0.0
            return near >= _PART_RATIO
        ratio = max(
            item.surface.contains(other.surface.points_map_m(), _MARGIN_M)
            for item, other in ((first, second), (second, first))
        )
        least = _MERGE_RATIO if is_alike else _MERGE_OTHER_RATIO
        return ratio >= least or _are_parts_of_a_chair(first, second)


def _pair(*ids: int) -> tuple[int, int]:
    a, b = sorted(ids)
    return a, b


def may_lie_on(radius_m: float, item: MappedObject) -> bool:
    """Return whether a thing of this radius may lie on a known object that is much larger."""
    is_large = item.surface.radius_m() > _SUPPORT_RATIO * radius_m
    return is_large and item.class_name not in BARE


def are_inside_each_other(first: MappedObject, second: MappedObject) -> bool:
    """Return whether two objects of a class are at one place, and therefore the same.

    An image may have shown both beside each other, because a detector may report two boxes for an
    object whose middle is hidden.
    """
    pairs = (
        (first, second.surface.solid_points_map_m()),
        (second, first.surface.solid_points_map_m()),
    )
    return first.class_name == second.class_name and all(
        item.surface.contains(points_m, _MARGIN_M) > _INSIDE_RATIO for item, points_m in pairs
    )


def _touching(objects: Sequence[MappedObject]) -> BoolArray:
    """Return the (O, O) mask of the pairs of objects whose bounding spheres touch.

    A chair has at least the sphere of a whole chair, because the object may be only a part.
    """
    centers = np.array([item.surface.center_map_m() for item in objects]).reshape(-1, 3)
    radii = np.array([item.surface.radius_m() for item in objects])
    is_chair = np.array([item.class_name == _CHAIR for item in objects], np.bool_)
    radii = np.maximum(radii, is_chair * _CHAIR_M / 2)
    distances = np.linalg.norm(centers[:, None] - centers, axis=2)
    return np.asarray(distances <= radii[:, None] + radii)


def _are_parts_of_a_chair(first: MappedObject, second: MappedObject) -> bool:
    """Return whether two chairs are parts of one chair, of which each image showed one part.

    Both are confirmed, the border of the image has cut them in all their sightings, and together
    they are no larger than one chair: the two horizontal lengths of their common box are compared.
    """
    both = first, second
    if not all(i.surface.is_cut and i.is_confirmed and i.class_name == _CHAIR for i in both):
        return False
    low, high = first.surface.box_m()
    T = first.surface.place.T_place_map @ second.surface.T_map_object
    box_m = zip(*second.surface.box_m(), strict=True)
    corners = se3.transform(T, np.array(list(product(*box_m))))
    size_m = np.maximum(high, corners.max(axis=0)) - np.minimum(low, corners.min(axis=0))
    return bool((size_m[:2] <= _CHAIR_M).all())


def _overlap_much(first_px: BoxPx, second_px: BoxPx) -> bool:
    """Return whether two boxes share over 70 % of the smaller one: an object detected twice."""
    a, b = first_px, second_px
    width, height = (min(a[i + 2], b[i + 2]) - max(a[i], b[i]) for i in range(2))
    smaller = min((box[2] - box[0]) * (box[3] - box[1]) for box in (a, b))
    return max(width, 0) * max(height, 0) > _DOUBLE_RATIO * smaller
