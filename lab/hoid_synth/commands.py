"""The command `hoid synth`."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from hoid_synth.bag import write_bag
from hoid_synth.config import SceneConfig

_MOST_WORKERS = 4
_FIELDS = {
    '--seed': 'seed',
    '--frames': 'num_frames',
    '--path': 'path',
    '--layout': 'layout',
    '--turned': 'turned',
    '--bare': 'bare',
    '--people': 'num_people',
    '--near': 'near_m',
    '--together': 'together',
    '--event': 'event',
    '--speed': 'speed_mps',
    '--played': 'played_s',
    '--rest': 'rest_s',
    '--people-seed': 'people_seed',
    '--away': 'away_seed',
    '--start': 'start_s',
    '--rooms': 'num_rooms',
    '--every': 'every',
    '--width': 'width_px',
    '--pitch': 'pitch_deg',
    '--roll': 'roll_deg',
    '--pace': 'pace',
    '--shutter': 'shutter_s',
    '--blur': 'motion_blur',
    '--smooth-depth': 'smooth_depth',
    '--color-every': 'color_every',
    '--swing': 'exposure_swing',
}
"""Options, and the fields of the configuration that they set."""
# Placeholders, by the unit at the end of a field's name.
_METAVARS = {'_m': 'M', '_s': 'S', '_mps': 'M/S', '_px': 'PX', '_deg': 'DEG'}


def add_synth_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hoid synth`."""
    parser.add_argument('bag', metavar='BAG', type=Path, help='folder of the new bag')
    leaves = {leaf.name: leaf for leaf in SceneConfig().params()}
    people = parser.add_mutually_exclusive_group()
    for option, name in _FIELDS.items():
        value, spec = leaves[name].value, leaves[name].spec
        if isinstance(value, bool):
            kind: dict[str, Any] = {'action': 'store_true', 'help': spec.description}
        else:
            kind = {'type': type(value), 'default': value}
            kind['help'] = spec.description + (' (default: %(default)s)' if value else '')
            if choices := [choice for choice in spec.choices if choice]:
                kind['choices'] = choices
            else:
                kind['metavar'] = _METAVARS.get(name[name.rfind('_') :], 'N')
        (people if name == 'num_people' else parser).add_argument(option, dest=name, **kind)
    people.add_argument(
        '--no-people', dest='num_people', action='store_const', const=0, help='render no people'
    )
    parser.add_argument(
        '--imu', action='store_true', help='also write the samples of an IMU at 200 Hz'
    )
    parser.add_argument(
        '--workers',
        type=int,
        default=min(_MOST_WORKERS, os.cpu_count() or 1),
        metavar='N',
        help=f'number of processes (default: one per core, at most {_MOST_WORKERS})',
    )


def synth_command(args: argparse.Namespace) -> None:
    """Render a scene into a bag."""
    write_bag(scene_config(args), args.bag, args.workers, imu=args.imu, show_progress=True)


def scene_config(args: argparse.Namespace) -> SceneConfig:
    """Return the scene that the arguments describe."""
    return SceneConfig(**{name: getattr(args, name) for name in _FIELDS.values()})
