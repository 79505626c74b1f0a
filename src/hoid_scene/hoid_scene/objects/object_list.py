"""Finds objects of the map by class, place and state, and lists them as a table or as YAML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np
import yaml

from hoid_common.errors import InputError
from hoid_common.values import NS_PER_S, FloatArray, ObjectState
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
_HEADER = (
    'id', 'class', 'center m', 'size m', 'yaw', 'last seen', 'there', 'score', 'seen', 'state',
)  # fmt: skip
_DIGITS = 3  # of lengths: millimeters


class ObjectQuery(NamedTuple):
    """The conditions that objects must fulfill to be found."""

    class_name: str = ''  # empty: any class
    near_map_m: FloatArray | None = None  # (3,) point in the map frame; None: anywhere
    radius_m: float = np.inf  # largest distance of the center from `near_map_m`, if given
    state: str = _PRESENT  # one of STATES

    def check(self) -> None:
        """Raise InputError if the state is unknown, or point or radius is invalid."""
        if self.state not in STATES:
            raise InputError(f'no state "{self.state[:40]}"; use one of {", ".join(STATES)}')
        near = np.zeros(3) if self.near_map_m is None else self.near_map_m
        if not np.isfinite(near).all() or np.isnan(self.radius_m) or self.radius_m < 0:
            raise InputError('the point must be finite, and the radius not negative')


def find(objects: Sequence[MapObject], query: ObjectQuery) -> list[MapObject]:
    """Return the objects that fulfill a query, which is checked first.

    With `near_map_m`, the nearest ones are first; otherwise they keep the order of `objects`.
    Tentative objects are found only if the query asks for them.
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
    state = item.state.name.lower()
    is_sure = item.state is not ObjectState.TENTATIVE
    is_in = {_PRESENT: item.is_present, _NEW: item.is_new and is_sure, _ANY: is_sure}
    return is_in.get(query.state, state == query.state)


def object_table(objects: Iterable[MapObject]) -> list[str]:
    """Return the lines of a table: headings, then one line for each object.

    Lengths are in m in the map frame, yaw is in degrees, times are stamps of images as UTC,
    "there" is the probability that the object is still there, "score" the mean score of its
    detections and "seen" their number.
    """
    rows = [_HEADER, *(_cells(item) for item in objects)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ['  '.join(map(str.ljust, row, widths)).rstrip() for row in rows]


def objects_yaml(objects: Sequence[MapObject], frame: str) -> str:
    """Return a YAML document with all objects, whose poses are in the given frame.

    Lengths are in m, angles in rad, and times are stamps of images in s.
    """
    document = {'frame': frame, 'objects': [_entry(item) for item in objects]}
    return str(yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=99))


def _cells(item: MapObject) -> tuple[str, ...]:
    state = item.state.name.lower().replace('_', ' ')
    if item.moved_from_map_m is not None:
        state += f' from {_lengths(item.moved_from_map_m, " ")}'
    return (
        str(item.object_id),
        item.class_name,
        _lengths(item.center_map_m, ' '),
        _lengths(item.size_m, ' x '),
        f'{np.rad2deg(_yaw_rad(item.T_map_object)):.0f} deg',
        f'{datetime.fromtimestamp(item.last_ns / NS_PER_S, UTC):%Y-%m-%d %H:%M:%S}',
        f'{100 * item.probability:.0f} %',
        f'{item.score:.2f}',
        str(item.num_sightings),
        state,
    )


def _lengths(values_m: FloatArray, separator: str) -> str:
    return separator.join(f'{value:.2f}' for value in values_m)


def _entry(item: MapObject) -> dict[str, Any]:
    entry: dict[str, Any] = {
        'id': item.object_id,
        'class': item.class_name,
        'scores': {name: round(score, _DIGITS) for name, score in item.class_scores},
        'score': round(item.score, _DIGITS),
        'state': item.state.name.lower(),
        'probability': round(item.probability, _DIGITS),
        'center': _rounded(item.center_map_m),
        'size': _rounded(item.size_m),
        'yaw': round(_yaw_rad(item.T_map_object), _DIGITS),
        'sightings': item.num_sightings,
        'views': item.num_views,
        'first_seen': item.first_ns / NS_PER_S,
        'last_seen': item.last_ns / NS_PER_S,
    }
    if item.moved_from_map_m is not None:
        entry |= {
            'moved_from': _rounded(item.moved_from_map_m),
            'moved_at': item.moved_ns / NS_PER_S,
        }
    if item.holder_id >= 0:
        entry['person'] = item.holder_id
    return entry


def _yaw_rad(T: FloatArray) -> float:
    return float(np.arctan2(T[1, 0], T[0, 0]))


def _rounded(values: FloatArray) -> list[float]:
    return [round(float(value), _DIGITS) for value in values]
