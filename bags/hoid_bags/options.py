"""Options shared by the commands that read TUM folders and bags."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.bag.bag_topics import TopicChoice
from hoid_bags.sequence import Sequence, open_sequence
from hoid_bags.tum.association import MAX_PAIR_GAP_NS
from hoid_bags.tum.cameras import TUM_DEPTH_UNITS_PER_M, find_camera
from hoid_common.camera_topics import CAMERA_TOPICS
from hoid_common.values import CameraModel


def add_folder_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options for the camera and the depth units of a TUM folder."""
    parser.add_argument(
        '--camera',
        metavar='fr1|fr2|fr3|bonn|YAML|DRIVER',
        help='camera: a published one, a camera_info YAML, or the driver that recorded a bag '
        f'({", ".join(CAMERA_TOPICS)}) (default: by the name of the folder or the topics)',
    )
    parser.add_argument(
        '--depth-factor',
        type=float,
        default=TUM_DEPTH_UNITS_PER_M,
        metavar='N',
        help='depth units per meter in the images of a TUM folder (default: %(default)g)',
    )


def add_topic_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options that name the topics of a bag, for a command without `--camera`."""
    _add_topic_names(parser)
    parser.add_argument(
        '--camera',
        metavar='PRESET',
        help=f'driver that recorded the bag: {", ".join(CAMERA_TOPICS)}',
    )


def add_recording_arguments(
    parser: argparse.ArgumentParser, what: str = 'TUM folder or bag'
) -> None:
    """Declare the argument for a recording, and the options for its topics, camera and units."""
    parser.add_argument('input', metavar='INPUT', type=Path, help=what)
    add_folder_arguments(parser)
    _add_topic_names(parser)


def _add_topic_names(parser: argparse.ArgumentParser) -> None:
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


def chosen_topics(args: argparse.Namespace) -> TopicChoice:
    """Return the topics that the options name, or the preset of a driver in `--camera`."""
    preset = args.camera if args.camera in CAMERA_TOPICS else ''
    return TopicChoice(args.rgb, args.depth, args.info, preset)


def open_recording(
    args: argparse.Namespace, path: Path, max_gap_ns: int = MAX_PAIR_GAP_NS
) -> Sequence:
    """Open a recording with the options of the command line, and print the topics of a bag.

    Raises:
        InputError: The recording cannot be read.
    """
    topics, camera = chosen_topics(args), chosen_camera(args)
    found = open_sequence(path, camera, args.depth_factor, topics, max_gap_ns)
    if isinstance(found, BagSequence):
        sys.stderr.write(f'{path}: {found.topics}\n')
    return found


def chosen_camera(args: argparse.Namespace) -> CameraModel | None:
    """Return the camera that `--camera` names; None without the option, or for a driver's name.

    Raises:
        InputError: The value is neither a known name nor a readable camera file.
    """
    if not args.camera or args.camera in CAMERA_TOPICS:
        return None
    return find_camera(args.camera)
