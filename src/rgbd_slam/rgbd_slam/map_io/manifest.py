"""The manifest of a map file: its camera, its features, and the lengths of its arrays."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, NamedTuple

from hoid_common.errors import MapFileError
from hoid_common.io.records import Record
from hoid_common.values import CameraModel
from hoid_scene.dense.dense_state import DenseState
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.objects.object_map_state import ObjectMapState
from rgbd_slam.map_io.archive import Reader
from rgbd_slam.model.map_state import MapState

VERSION = 1
FORMAT = 'hoid map'
SECTIONS: dict[str, type[Record]] = {
    'map': MapState,
    'submaps': SubmapState,
    'objects': ObjectMapState,
    'dense': DenseState,  # the images of the dense map, in files of earlier versions
}
MAX_DISTORTION = 14  # number of coefficients of OpenCV's largest lens model
_MAX_ROWS = 2**31


class Manifest(NamedTuple):
    """The camera of a map file, the octaves of its features, and the lengths of its arrays."""

    camera: CameraModel
    scale_factor: float
    num_octaves: int
    lengths: dict[str, dict[str, int]]  # lengths of the named axes, by section of the file


def read_manifest(reader: Reader) -> Manifest:
    """Return the manifest of a map file, after checking its version and its values.

    Raises:
        MapFileError: The file is not a map, of another version, or damaged.
    """
    content = reader.manifest()
    if content.get('format') != FORMAT:
        raise MapFileError('is no map file: its manifest is of something else')
    if content.get('version') != VERSION:
        raise MapFileError(
            f'is of version {content.get("version")!r:.20}, and this program reads version '
            f'{VERSION}: save the map anew with the program that made it'
        )
    if isinstance(content.get('camera'), dict):  # maps of earlier versions have no fisheye cameras
        content['camera'].setdefault('is_fisheye', False)
    for name, schema in _schema(content.get('lengths')).items():
        if not _conforms(content.get(name), schema):
            raise MapFileError(f'is damaged: "{name}" in its manifest is invalid')
    camera = content['camera'] | {'distortion': tuple(content['camera']['distortion'])}
    return Manifest(
        CameraModel(**camera),
        float(content['scale_factor']),
        content['num_octaves'],
        content['lengths'],
    )


def _schema(sections: object) -> dict[str, Any]:
    """Return the schema of a manifest: nested dictionaries with a predicate for each value.

    Args:
        sections: The value of `lengths` in the manifest, which may be invalid. Its keys say which
            of the sections besides `map`, which is required, the file has.
    """
    camera = {field.name: _is_number for field in fields(CameraModel)}
    size = {'width_px': _is_count, 'height_px': _is_count}
    present = {'map', *sections} if isinstance(sections, dict) else {'map'}
    return {
        'camera': camera | size | {'distortion': _is_distortion, 'is_fisheye': _is_flag},
        'scale_factor': _is_number,
        'num_octaves': _is_count,
        'lengths': {
            name: dict.fromkeys(_axes(record), _is_count)
            for name, record in SECTIONS.items()
            if name in present
        },
    }


def _is_flag(value: object) -> bool:
    return isinstance(value, bool)


def _axes(record: type[Record]) -> set[str]:
    columns = record.columns().values()
    return {axis for column in columns for axis in column.axes if isinstance(axis, str)}


def _conforms(value: object, schema: Any) -> bool:
    if not isinstance(schema, dict):
        return bool(schema(value))
    if not isinstance(value, dict) or value.keys() != schema.keys():
        return False
    return all(_conforms(value[name], inner) for name, inner in schema.items())


def _is_number(value: object) -> bool:
    return type(value) in (int, float)  # `bool` is a subclass of `int`, and no number


def _is_count(value: object) -> bool:
    return type(value) is int and 0 <= value < _MAX_ROWS


def _is_distortion(value: object) -> bool:
    if not isinstance(value, list) or len(value) > MAX_DISTORTION:
        return False
    return all(map(_is_number, value))
