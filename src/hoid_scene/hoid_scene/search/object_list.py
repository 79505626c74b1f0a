"""Lists objects of the map as a table, as YAML or as JSON, and their histories as text."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np
import yaml

from hoid_common import se3
from hoid_common.values import NS_PER_S, FloatArray
from hoid_scene.memory.history import EventKind
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.search.relations import described
from hoid_scene.search.rooms import Rooms, room_name

_HEADER = (
    'id', 'class', 'color', 'where', 'center m', 'size m', 'yaw', 'last seen', 'there', 'score',
    'seen', 'state',
)  # fmt: skip
_DIGITS = 3  # decimals of lengths in m: millimeters
_EVENTS = {
    EventKind.NEW: 'new',
    EventKind.SEEN: 'seen again',
    EventKind.CARRIED: 'carried',
    EventKind.PUT_DOWN: 'put down',
    EventKind.GONE: 'gone',
}


class Whereabouts(NamedTuple):
    """Where an object is, in words."""

    room: str = ''  # '': in no room
    places: tuple[str, ...] = ()  # such as "on dining table 3"


def whereabouts(item: MapObject, objects: Sequence[MapObject], rooms: Rooms | None) -> Whereabouts:
    """Return the room and relations of an object; `rooms` None: rooms are unknown."""
    return Whereabouts(room_name(item, rooms), described(item, objects))


def object_table(objects: Iterable[MapObject], where: Iterable[Whereabouts]) -> list[str]:
    """Return the lines of a table: headings, then one line for each object.

    Lengths are in m in the map frame, yaw is in degrees, times are stamps of images as UTC,
    "there" is the probability that the object is still there, "score" the mean score of its
    detections and "seen" their number.
    """
    rows = [_HEADER, *map(_cells, objects, where)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ['  '.join(map(str.ljust, row, widths)).rstrip() for row in rows]


def history_lines(item: MapObject) -> Iterator[str]:
    """Yield the number and the class of an object, then one line for each event."""
    yield f'{item.object_id} {item.class_name}'
    for event in item.events:
        words = _EVENTS[event.kind]
        if event.kind is EventKind.PUT_DOWN:
            words += f' {event.distance_m:.2f} m away'
        if event.person_id >= 0:
            words += f' by person {event.person_id}'
        yield f'  {_time(event.stamp_ns)}  {words}'


def objects_json(objects: Sequence[MapObject], where: Sequence[Whereabouts], frame: str) -> str:
    """Return a JSON document: the content of `objects_yaml` plus rooms, places and pictures."""
    entries = []
    for item, place in zip(objects, where, strict=True):
        picture = base64.b64encode(item.jpeg).decode()
        entries.append(_entry(item) | {**place._asdict(), 'picture': picture})
    document = {'format': 'hoid objects 1', 'frame': frame, 'objects': entries}
    return json.dumps(document, indent=1) + '\n'


def objects_yaml(objects: Sequence[MapObject], frame: str) -> str:
    """Return a YAML document with all objects, whose poses are in the given frame.

    Lengths are in m, angles in rad, and times are stamps of images in s.
    """
    document = {'frame': frame, 'objects': [_entry(item) for item in objects]}
    return str(yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=99))


def _cells(item: MapObject, where: Whereabouts) -> tuple[str, ...]:
    state = item.state.name.lower().replace('_', ' ')
    if item.moved_from_map_m is not None:
        state += f' from {_lengths(item.moved_from_map_m, " ")}'
    return (
        str(item.object_id),
        item.class_name,
        ' '.join(item.colors),
        ', '.join(filter(None, (where.room, *where.places))),
        _lengths(item.center_map_m, ' '),
        _lengths(item.size_m, ' x '),
        f'{np.rad2deg(_yaw_rad(item.T_map_object)):.0f} deg',
        _time(item.last_ns),
        f'{100 * item.probability:.0f} %',
        f'{item.score:.2f}',
        str(item.num_sightings),
        state,
    )


def _time(stamp_ns: int) -> str:
    return f'{datetime.fromtimestamp(stamp_ns / NS_PER_S, UTC):%Y-%m-%d %H:%M:%S}'


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
        'orientation': _rounded(se3.quat_xyzw_from_rotation(item.T_map_object[:3, :3])),
        'colors': list(item.colors),
        'sightings': item.num_sightings,
        'views': item.num_views,
        'first_seen': item.first_ns / NS_PER_S,
        'last_seen': item.last_ns / NS_PER_S,
        'history': [
            {
                'time': event.stamp_ns / NS_PER_S,
                'event': event.kind.name.lower(),
                'person': event.person_id,
                'distance': round(event.distance_m, _DIGITS),
            }
            for event in item.events
        ],
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
