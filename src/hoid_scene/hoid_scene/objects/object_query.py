"""Finds objects of the map by class, place and state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hoid_common.errors import InputError
from hoid_common.values import FloatArray, ObjectState
from hoid_scene.objects.mapped_object import MapObject

_PRESENT, _NEW, _ANY = 'present', 'new', 'any'
_OF_OBJECTS = (
    ObjectState.AT_REST,
    ObjectState.MOVED,
    ObjectState.HANDLED,
    ObjectState.GONE,
    ObjectState.TENTATIVE,
)
STATES = (_PRESENT, *(state.name.lower() for state in _OF_OBJECTS), _NEW, _ANY)


class ObjectQuery(NamedTuple):
    """The conditions that objects must fulfill to be found."""

    class_name: str = ''  # empty: any class
    near_map_m: FloatArray | None = None  # (3,) point in the map frame; None: anywhere
    radius_m: float = np.inf  # largest distance of the center from `near_map_m`, if given
    state: str = _PRESENT  # one of STATES

    def check(self) -> None:
        """Raise InputError if the state is unknown, or point or radius is invalid.

        The point must be finite, and the radius must be neither negative nor NaN.
        """
        if self.state not in STATES:
            raise InputError(f'no state "{self.state[:40]}"; use one of {", ".join(STATES)}')
        near = np.zeros(3) if self.near_map_m is None else self.near_map_m
        if not np.isfinite(near).all() or np.isnan(self.radius_m) or self.radius_m < 0:
            raise InputError('the point must be finite, and the radius not negative')


def find(objects: Sequence[MapObject], query: ObjectQuery) -> list[MapObject]:
    """Return the objects that fulfill a query.

    With `near_map_m`, the nearest ones are first; otherwise they keep the order of `objects`.

    Raises:
        InputError: The state is unknown, the point is not finite, or the radius is negative or
            NaN.
    """
    query.check()
    found = [item for item in objects if _is_meant(item, query)]
    near_m = query.near_map_m
    if near_m is None:
        return found
    distances_m = [float(np.linalg.norm(item.center_map_m - near_m)) for item in found]
    order = np.argsort(distances_m, kind='stable').tolist()
    return [found[i] for i in order if distances_m[i] <= query.radius_m]


def _is_meant(item: MapObject, query: ObjectQuery) -> bool:
    if query.class_name and item.class_name != query.class_name:
        return False
    match query.state:
        case 'present':
            return item.state.is_at_rest
        case 'new':
            return item.is_new
        case 'any':
            return True
        case name:
            return item.state.name.lower() == name
