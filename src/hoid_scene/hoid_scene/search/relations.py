"""Where an object is relative to others: on, in, under or next to them, by their boxes."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from hoid_scene.objects.mapped_object import MapObject


class Relation(Enum):
    """Where an object is relative to another one."""

    ON = 'on'
    IN = 'in'
    UNDER = 'under'
    NEXT_TO = 'next to'


# Chosen, because boxes are accurate to a few centimeters: an object lies on another one if their
# surfaces are at most this far apart, and beside it if its center is more than this outside of the
# footprint.
_TOUCH_M, _MARGIN_M = 0.12, 0.05
_NEAR_M = 0.6  # chosen: gap between the boxes of things that stand next to each other
# Furniture with a back: the height of its seat as a share of the height of its box. Things on the
# seat are below the top of the box.
_SEATS = {'couch': 0.25, 'chair': 0.3, 'bed': 0.2, 'bench': 0.3, 'toilet': 0.3}
# Classes of things that contain others.
_CONTAINERS = frozenset(
    {
        'sink',
        'bowl',
        'backpack',
        'handbag',
        'suitcase',
        'refrigerator',
        'oven',
        'microwave',
        'vase',
    }
)


def is_related(item: MapObject, relation: Relation, other: MapObject) -> bool:
    """Return whether an object has a relation to another one.

    ON: `item` is on top of `other` (for seats, above the seat), with its center over it. IN:
    `other` is a container, and the center of `item` is in its box. UNDER: `item` is lower, with
    its center below `other`. NEXT_TO: the gap between the boxes is less than 60 cm, and no other
    relation holds.
    """
    if item.object_id == other.object_id:
        return False
    if relation is Relation.NEXT_TO:
        return _are_beside(item, other)
    return relation is _vertical_relation(item, other)


def _vertical_relation(item: MapObject, other: MapObject) -> Relation | None:
    """Return ON, IN or UNDER if an object has this relation to another object, else None."""
    if _gap_m(item.center_map_m, other) > _MARGIN_M:
        return None
    is_smaller = item.size_m[:2].prod() < other.size_m[:2].prod()
    low_m, high_m = _heights_m(item)
    other_low_m, other_high_m = _heights_m(other)
    share = _SEATS.get(other.class_name)
    is_on = is_smaller and abs(low_m - other_high_m) <= _TOUCH_M
    if share is not None:
        seat_m = other_low_m + share * (other_high_m - other_low_m)
        is_on = is_smaller and seat_m <= low_m <= other_high_m + _TOUCH_M
    if is_on:
        return Relation.ON
    is_within = other_low_m <= (low_m + high_m) / 2 <= other_high_m
    if is_within and is_smaller and other.class_name in _CONTAINERS:
        return Relation.IN
    return Relation.UNDER if high_m <= other_high_m - _TOUCH_M else None


def _are_beside(item: MapObject, other: MapObject) -> bool:
    if _vertical_relation(item, other) or _vertical_relation(other, item):
        return False
    (low_m, high_m), (other_low_m, other_high_m) = _heights_m(item), _heights_m(other)
    is_level = low_m <= other_high_m + _TOUCH_M and other_low_m <= high_m + _TOUCH_M
    return is_level and _between_m(item, other) <= _NEAR_M


def described(item: MapObject, objects: Sequence[MapObject]) -> tuple[str, ...]:
    """Return the relations of an object to present objects, as in ("on dining table 3", ...).

    The nearest object beside it is named only if it is not on, in or under something.
    """
    present = [other for other in objects if other.is_present and other is not item]
    places = [
        f'{relation.value} {other.class_name} {other.object_id}'
        for relation in (Relation.ON, Relation.IN, Relation.UNDER)
        for other in present
        if is_related(item, relation, other)
    ]
    beside = [other for other in present if is_related(item, Relation.NEXT_TO, other)]
    if places or not beside:
        return tuple(places)
    nearest = min(beside, key=lambda other: _between_m(item, other))
    return (f'{Relation.NEXT_TO.value} {nearest.class_name} {nearest.object_id}',)


def _heights_m(item: MapObject) -> tuple[float, float]:
    """Return the lowest and the highest coordinate [m] of a box along its own vertical."""
    up = item.T_map_object[:3, 2]
    center_m, half_m = float(up @ item.center_map_m), float(item.size_m[2]) / 2
    return center_m - half_m, center_m + half_m


def _gap_m(point_map_m: FloatArray, other: MapObject) -> float:
    """Return the horizontal distance [m] of a point (3,) from a box; 0 above, below or in it."""
    local_m = se3.transform(se3.inverse(other.T_map_object), point_map_m[None])[0]
    outside_m = np.maximum(np.abs(local_m[:2]) - other.size_m[:2] / 2, 0)
    return float(np.linalg.norm(outside_m))


def _between_m(item: MapObject, other: MapObject) -> float:
    """Return the horizontal gap [m] between two boxes, from the corners and the center of each."""
    signs = np.array([[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0], [0, 0, 0]])
    gaps = []
    for first, second in ((item, other), (other, item)):
        corners_m = se3.transform(first.T_map_object, signs * first.size_m / 2)
        gaps += [_gap_m(corner_m, second) for corner_m in corners_m]
    return min(gaps)
