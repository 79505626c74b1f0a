"""Options shared by the commands that read TUM folders."""

from __future__ import annotations

import argparse

from hoid_bags.tum.cameras import TUM_DEPTH_UNITS_PER_M, find_camera
from hoid_common.values import CameraModel


def add_folder_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options for the camera and the depth units of a TUM folder."""
    parser.add_argument(
        '--camera',
        metavar='fr1|fr2|fr3|bonn|YAML',
        help='camera of a TUM folder: a published one, or a camera_info YAML (default: by the '
        'name of the folder)',
    )
    parser.add_argument(
        '--depth-factor',
        type=float,
        default=TUM_DEPTH_UNITS_PER_M,
        metavar='N',
        help='depth units per meter in the images of a TUM folder (default: %(default)g)',
    )


def chosen_camera(args: argparse.Namespace) -> CameraModel | None:
    """Return the camera that `--camera` names, or None without the option.

    Raises:
        InputError: It is neither a known name nor a readable camera file.
    """
    return find_camera(args.camera) if args.camera else None
