"""Objects of the map as text: a table for people, and YAML for programs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
import yaml

from hoid_common.values import NS_PER_S, FloatArray
from hoid_scene.objects.mapped_object import MapObject

_HEADER = ('id', 'class', 'center m', 'size m', 'yaw', 'last seen', 'there', 'state')
_DIGITS = 3  # of lengths: millimeters


def object_table(objects: Iterable[MapObject]) -> list[str]:
    """Return the lines of a table: headings, then one line for each object.

    Lengths are in m in the map frame, yaw is in degrees, times are stamps of images as UTC, and
    "there" is the probability that the object is still there.
    """
    rows = [_HEADER, *(_cells(item) for item in objects)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ['  '.join(map(str.ljust, row, widths)).rstrip() for row in rows]


def objects_yaml(objects: Sequence[MapObject], frame: str) -> str:
    """Return a YAML document with all objects.

    Lengths are in m, angles in rad, and times are stamps of images in s.

    Args:
        objects: The objects.
        frame: Name of the map frame.
    """
    document = {'frame': frame, 'objects': [_entry(item) for item in objects]}
    return str(yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=99))


def _cells(item: MapObject) -> tuple[str, ...]:
    seen = datetime.fromtimestamp(item.last_ns / NS_PER_S, UTC)
    return (
        str(item.object_id),
        item.class_name,
        ' '.join(f'{value:.2f}' for value in item.center_map_m),
        ' x '.join(f'{value:.2f}' for value in item.size_m),
        f'{np.rad2deg(_yaw_rad(item.T_map_object)):.0f} deg',
        f'{seen:%Y-%m-%d %H:%M:%S}',
        f'{100 * item.probability:.0f} %',
        _state(item),
    )


def _state(item: MapObject) -> str:
    text = item.state.name.lower().replace('_', ' ')
    if item.moved_from_map_m is not None:
        text += f' from {" ".join(f"{value:.2f}" for value in item.moved_from_map_m)}'
    return text


def _entry(item: MapObject) -> dict[str, Any]:
    entry: dict[str, Any] = {
        'id': item.object_id,
        'class': item.class_name,
        'scores': {name: round(score, _DIGITS) for name, score in item.class_scores},
        'state': item.state.name.lower(),
        'probability': round(item.probability, _DIGITS),
        'center': _rounded(item.center_map_m),
        'size': _rounded(item.size_m),
        'yaw': round(_yaw_rad(item.T_map_object), _DIGITS),
        'sightings': item.num_sightings,
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
