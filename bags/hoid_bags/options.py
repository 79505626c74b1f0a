"""Options of commands, and the recording that they name."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any, TypeVar

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.bag.bag_topics import TopicChoice
from hoid_bags.sequence import Sequence, open_sequence
from hoid_bags.tum.association import MAX_PAIR_GAP_NS
from hoid_bags.tum.cameras import TUM_DEPTH_UNITS_PER_M, find_camera
from hoid_common.camera_topics import CAMERA_TOPICS
from hoid_common.config import Config
from hoid_common.errors import ConfigError
from hoid_common.topics import image_base
from hoid_common.values import NS_PER_S, CameraModel

C = TypeVar('C', bound=Config)


def add_folder_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options `--calibration` (alias `--camera`) and `--depth-factor`."""
    parser.add_argument(
        '--calibration',
        '--camera',
        metavar='fr1|fr2|fr3|bonn|YAML',
        help='a published calibration, or a camera_info YAML (default: by the '
        'name of the folder, or the camera_info of the bag)',
    )
    parser.add_argument(
        '--depth-factor',
        type=float,
        metavar='N',
        help=f'depth units per meter (default: {TUM_DEPTH_UNITS_PER_M:g} in a TUM folder; in a '
        'bag 1000 for whole numbers and 1 for floats)',
    )


def add_topic_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that name the topics of a bag, or the driver that recorded it."""
    for option, what in (
        ('rgb', 'color images'),
        ('depth', 'depth images'),
        ('info', 'the camera'),
    ):
        parser.add_argument(
            f'--{option}',
            default='',
            metavar='TOPIC',
            help=f'topic of {what} in a bag (default: found)',
        )
    parser.add_argument(
        '--depth-offset',
        type=float,
        default=0.0,
        metavar='S',
        help='time by which the stamps of depth are later than those of color in s '
        '(default: %(default)g)',
    )
    parser.add_argument(
        '--driver',
        choices=tuple(CAMERA_TOPICS),
        default='',
        help='driver that recorded the bag (default: any)',
    )


def add_recording_arguments(
    parser: argparse.ArgumentParser, what: str = 'folder of images, .sens file or bag'
) -> None:
    """Declare the argument for a recording, and the options for its topics, camera and units."""
    parser.add_argument('input', metavar='INPUT', type=Path, help=what)
    add_folder_arguments(parser)
    add_topic_arguments(parser)


def add_config_arguments(parser: argparse.ArgumentParser, config: Config) -> None:
    """Declare an option for each parameter that is not internal; `start_s` becomes `--start`."""
    for name, value, spec in config.node_params():
        option = name.removesuffix('_s').replace('_', '-')
        if isinstance(value, bool):
            parser.add_argument(f'--{option}', action='store_true', help=spec.description)
            continue
        parser.add_argument(
            f'--{option}',
            dest=name,
            type=type(value),
            default=value,
            choices=spec.choices or None,
            metavar=None if spec.choices else 'S' if name.endswith('_s') else 'N',
            help=f'{spec.description} (default: %(default)s)',
        )


def config_from(args: argparse.Namespace, kind: type[C], **internal: Any) -> C:
    """Return the configuration that command-line options set; ConfigError if one is invalid."""
    return kind(**{p.name: getattr(args, p.name) for p in kind().node_params()}, **internal)


def depth_offset_ns(args: argparse.Namespace) -> int:
    offset_s: float = args.depth_offset
    return round(offset_s * NS_PER_S)


def depth_units_per_m(args: argparse.Namespace) -> float | None:
    """Return `--depth-factor`, None without it; ConfigError unless it is positive and finite."""
    units: float | None = args.depth_factor
    if units is not None and not 0 < units < math.inf:
        raise ConfigError(f'--depth-factor: depth units per meter must be positive, got {units:g}')
    return units


def chosen_topics(args: argparse.Namespace) -> TopicChoice:
    return TopicChoice(args.rgb, args.depth, args.info, args.driver)


def open_recording(
    args: argparse.Namespace, path: Path, max_gap_ns: int = MAX_PAIR_GAP_NS
) -> Sequence:
    """Open a recording with the options of the command line; print the chosen inputs on stderr.

    InputError if the recording or the camera file cannot be read. ConfigError if the depth units
    are not positive, a folder lists a file with an impossible name, or `--driver` is given for a
    folder.
    """
    topics, camera = chosen_topics(args), chosen_camera(args)
    found = open_sequence(
        path, camera, depth_units_per_m(args), topics, max_gap_ns, depth_offset_ns(args)
    )
    taken = str(found.topics if isinstance(found, BagSequence) else found)
    if taken:
        sys.stderr.write(f'{path}: {taken}\n')
    if isinstance(found, BagSequence):
        if args.driver and not _is_of_driver(found.topics.color.name, args.driver):
            sys.stderr.write(
                f'{path}: these are not the topics of the driver {args.driver}, such as '
                f'{CAMERA_TOPICS[args.driver].topics()[0]}\n'
            )
    elif args.driver:
        raise ConfigError(f'--driver {args.driver}: {path} is no bag and has no topics')
    return found


def _is_of_driver(topic: str, driver: str) -> bool:
    return f'/{image_base(topic)}'.endswith(f'/{CAMERA_TOPICS[driver].rgb_image}')


def chosen_camera(args: argparse.Namespace) -> CameraModel | None:
    """Return the camera that `--calibration` names (see `find_camera`); None without it."""
    if args.calibration in CAMERA_TOPICS:
        name = args.calibration
        raise ConfigError(f'--camera {name}: the driver that recorded a bag is --driver {name}')
    return find_camera(args.calibration) if args.calibration else None
