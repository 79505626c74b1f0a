"""The command `objects`: finds and lists the objects of a saved map, with their history."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from hoid_bringup.maps.map_command import scene_of
from hoid_common.errors import InputError
from hoid_common.io.files import write_file
from hoid_common.io.images import encode_jpeg
from hoid_common.store.database import SUFFIX
from hoid_common.store.map_directory import named_map
from hoid_common.values import NS_PER_S
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.search import object_list
from hoid_scene.search.object_query import STATES, ObjectQuery, find
from hoid_scene.search.picture_sheet import picture_sheet
from hoid_scene.search.rooms import room_name
from hoid_scene.store.scene_file import restored
from rgbd_slam.config.node_config import FrameConfig
from rgbd_slam.store import map_file

_QUALITY = 85  # chosen: JPEG quality
_UNITS_NS = {'s': NS_PER_S, 'm': 60 * NS_PER_S, 'h': 3600 * NS_PER_S, 'd': 86400 * NS_PER_S}


def add_objects_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('map', type=Path, metavar='FILE', help=f'saved {SUFFIX} file')
    parser.add_argument(
        'words',
        nargs='*',
        metavar='WORD',
        help='list what the words describe, as in "red cup on the table in the kitchen"',
    )
    parser.add_argument(
        '--class',
        dest='class_name',
        default='',
        metavar='NAME',
        help='list objects of this class',
    )
    parser.add_argument(
        '--near',
        type=float,
        nargs=3,
        metavar=('X', 'Y', 'Z'),
        help='list the objects nearest to this point (m) first',
    )
    parser.add_argument(
        '--radius',
        type=float,
        default=np.inf,
        metavar='M',
        help='with --near: largest distance',
    )
    parser.add_argument(
        '--state',
        choices=STATES,
        default='any',
        help='list objects in this state (default: %(default)s)',
    )
    parser.add_argument(
        '--since',
        type=_age_or_time,
        metavar='TIME',
        help='list objects that are new, were moved or are gone since 2026-11-27T18:00 (UTC), or '
        'for an age such as 30m, 3h or 2d',
    )
    parser.add_argument(
        '--history',
        default=None,
        metavar='NAME',
        help='show the history of the objects that NAME, words or a number, describes',
    )
    parser.add_argument(
        '--pictures',
        type=Path,
        metavar='DIR',
        help='write the pictures of the objects',
    )
    parser.add_argument(
        '--json',
        type=Path,
        metavar='FILE',
        help='write the list, with histories and pictures, as JSON',
    )
    parser.add_argument('--yaml', type=Path, metavar='FILE', help='write the list as YAML')


def objects_command(args: argparse.Namespace) -> None:
    """List the objects of a saved map that the options select; also write files if requested.

    Only the main map of the file is used, which has most keyframes.
    """
    path = named_map(args.map)
    content, scene = map_file.load(path), scene_of(path)
    if scene.objects is None:
        raise InputError(
            f'{args.map}: has no object map: set object_map.enabled to true where it is made'
        )
    mapper = restored(scene, content.keyframes(), content.camera)
    every = mapper.mapped_objects(tentative=True)
    rooms = mapper.rooms(every)
    query = _query(args, every)
    objects = find(every, query, lambda item: room_name(item, rooms))
    if args.history is not None and args.history.isdigit():
        objects = [item for item in every if item.object_id == int(args.history)]
    where = [object_list.whereabouts(item, every, rooms) for item in objects]
    if args.history is None:
        lines = object_list.object_table(objects, where)
    else:
        lines = [line for item in objects for line in object_list.history_lines(item)]
    sys.stdout.writelines(f'{line}\n' for line in lines)
    _write_files(args, objects, where)


def _write_files(
    args: argparse.Namespace,
    objects: Sequence[MapObject],
    where: Sequence[object_list.Whereabouts],
) -> None:
    frame = FrameConfig().map
    if args.yaml is not None:
        write_file(args.yaml, object_list.objects_yaml(objects, frame).encode())
    if args.json is not None:
        write_file(args.json, object_list.objects_json(objects, where, frame).encode())
    if args.pictures is not None:
        if (sheet := picture_sheet(objects)) is not None:
            write_file(args.pictures / 'all.jpg', encode_jpeg(sheet, _QUALITY))
        for item in objects:
            if item.jpeg:
                name = re.sub(r'\W', '_', item.class_name)
                write_file(args.pictures / f'{item.object_id}_{name}.jpg', item.jpeg)


def _query(args: argparse.Namespace, objects: Sequence[MapObject]) -> ObjectQuery:
    near = None if args.near is None else np.array(args.near)
    is_number = args.history is None or args.history.isdigit()
    words = ' '.join(args.words) or args.class_name or ('' if is_number else args.history)
    since_ns = None
    if isinstance(args.since, datetime):
        since_ns = int(args.since.timestamp() * NS_PER_S)
    elif args.since is not None:
        newest_ns = max((item.last_ns for item in objects), default=0)
        since_ns = max(newest_ns - args.since, 0)
    return ObjectQuery(words, near, args.radius, args.state, since_ns)


def _age_or_time(text: str) -> int | datetime:
    """Return an age (ns), or a time, which is in UTC unless it names another zone."""
    if age := re.fullmatch(r'(\d{1,6})([smhd])', text):
        return int(age[1]) * _UNITS_NS[age[2]]
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f'{text!r} is neither a time, as 2026-11-27T18:00, nor an age, as 30m, 3h or 2d'
        ) from None
    return time if time.tzinfo else time.replace(tzinfo=UTC)
