"""The command `objects`: lists the objects of a saved map."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from hoid_bringup.maps.map_command import scene_of
from hoid_common.errors import InputError
from hoid_common.io.files import write_error
from hoid_common.store.database import SUFFIX
from hoid_common.store.map_directory import named_map
from hoid_scene.objects.object_list import STATES, ObjectQuery, find, object_table, objects_yaml
from hoid_scene.store.scene_file import saved_objects
from rgbd_slam.config.node_config import FrameConfig
from rgbd_slam.store import map_file


def add_objects_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('map', type=Path, metavar='FILE', help=f'saved {SUFFIX} file')
    parser.add_argument(
        '--class',
        dest='class_name',
        default='',
        metavar='NAME',
        help='list only objects of this class',
    )
    parser.add_argument(
        '--near',
        type=float,
        nargs=3,
        metavar=('X', 'Y', 'Z'),
        help='list the objects nearest to this point of the map frame first, in m',
    )
    parser.add_argument(
        '--radius',
        type=float,
        default=np.inf,
        metavar='M',
        help='with --near: list only objects whose center is within this distance',
    )
    parser.add_argument(
        '--state',
        choices=STATES,
        default='any',
        help='list only objects in this state (default: %(default)s)',
    )
    parser.add_argument(
        '--yaml', type=Path, metavar='FILE', help='write the listed objects to a YAML file as well'
    )


def objects_command(args: argparse.Namespace) -> None:
    """List the objects of a saved map that the options select, and write them to a file if given.

    Of several maps in the file, only the one with most keyframes counts.
    """
    path = named_map(args.map)
    content, scene = map_file.load(path), scene_of(path)
    if scene.objects is None:
        raise InputError(
            f'{args.map}: has no object map: set object_map.enabled to true where it is made'
        )
    near = None if args.near is None else np.array(args.near)
    query = ObjectQuery(args.class_name, near, args.radius, args.state)
    every = saved_objects(scene, content.keyframes(), content.camera, tentative=True)
    objects = find(every, query)
    sys.stdout.writelines(f'{line}\n' for line in object_table(objects))
    if args.yaml is not None:
        try:
            args.yaml.write_text(objects_yaml(objects, FrameConfig().map), encoding='utf-8')
        except OSError as error:
            raise write_error(args.yaml, error) from error
