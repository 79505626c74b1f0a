"""The command `hoid synth`."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from hoid_synth.bag import write_bag
from hoid_synth.config import EVENTS, LAYOUTS, PATHS, SceneConfig

_MOST_WORKERS = 4


def add_synth_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `hoid synth`."""
    default = SceneConfig()
    parser.add_argument('bag', metavar='BAG', type=Path, help='folder of the new bag')
    parser.add_argument(
        '--seed',
        type=int,
        default=default.seed,
        help='seed of all random choices (default: %(default)s)',
    )
    parser.add_argument(
        '--frames',
        type=int,
        default=default.num_frames,
        help='number of frames at 30 Hz (default: 300, or 1200 for the path loop)',
    )
    parser.add_argument(
        '--path', choices=PATHS, default=default.path, help='camera motion (default: %(default)s)'
    )
    parser.add_argument(
        '--layout',
        choices=LAYOUTS,
        default=default.layout,
        help='furniture: a home, or rows of identical pieces (repeated)',
    )
    people = parser.add_mutually_exclusive_group()
    people.add_argument(
        '--people',
        type=int,
        default=default.num_people,
        help='number of people (default: %(default)s)',
    )
    people.add_argument(
        '--no-people', dest='people', action='store_const', const=0, help='render no people'
    )
    parser.add_argument(
        '--near',
        type=float,
        default=default.near_m,
        help='distance to the camera that people keep in m (default: %(default)s)',
    )
    parser.add_argument(
        '--together',
        action='store_true',
        help='people walk past the camera as one group, back and forth, at the distance of --near',
    )
    parser.add_argument(
        '--event',
        choices=EVENTS,
        default=default.event,
        help='object that people carry past the camera or take away, or that moves by itself',
    )
    parser.add_argument(
        '--speed',
        type=float,
        default=default.speed_mps,
        metavar='M/S',
        help='speed of the object of --event, which then stays in view (default: the usual one)',
    )
    parser.add_argument(
        '--played',
        type=float,
        default=default.played_s,
        metavar='S',
        help='time of people and event before the first frame in s',
    )
    parser.add_argument(
        '--rest',
        type=float,
        default=default.rest_s,
        metavar='S',
        help='time for which people stand still at first in s',
    )
    parser.add_argument(
        '--people-seed',
        type=int,
        default=default.people_seed,
        metavar='N',
        help='seed of the people and their actions only',
    )
    parser.add_argument(
        '--start',
        type=float,
        default=default.start_s,
        metavar='S',
        help='start time on the camera path in s',
    )
    parser.add_argument(
        '--width',
        type=int,
        default=default.width_px,
        help='width of the images in pixels (default: %(default)s)',
    )
    parser.add_argument(
        '--workers',
        type=int,
        default=min(_MOST_WORKERS, os.cpu_count() or 1),
        help=f'number of processes (default: one per core, at most {_MOST_WORKERS})',
    )


def synth_command(args: argparse.Namespace) -> None:
    """Render a scene into a bag."""
    write_bag(scene_config(args), args.bag, args.workers, show_progress=True)


def scene_config(args: argparse.Namespace) -> SceneConfig:
    """Return the scene that the arguments describe."""
    return SceneConfig(
        seed=args.seed,
        num_frames=args.frames,
        width_px=args.width,
        path=args.path,
        layout=args.layout,
        num_people=args.people,
        near_m=args.near,
        together=args.together,
        event=args.event,
        speed_mps=args.speed,
        played_s=args.played,
        rest_s=args.rest,
        people_seed=args.people_seed,
        start_s=args.start,
    )
