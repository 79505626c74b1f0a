"""Options that all commands share which read TUM folders."""

from __future__ import annotations

import argparse

from hoid_bags.tum.cameras import TUM_DEPTH_UNITS_PER_M, find_camera
from hoid_common.values import CameraModel


def add_folder_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what a TUM folder itself does not say: its camera and the units of its depth."""
    parser.add_argument(
        '--camera',
        metavar='fr1|fr2|fr3|bonn|YAML',
        help='camera of a folder: a published one, or a camera_info YAML (default: by its name)',
    )
    parser.add_argument(
        '--depth-factor',
        type=float,
        default=TUM_DEPTH_UNITS_PER_M,
        metavar='N',
        help="depth units per metre of a folder's images (default: %(default)g)",
    )


def chosen_camera(args: argparse.Namespace) -> CameraModel | None:
    """Return the camera that `--camera` names, or None without the option.

    Raises:
        InputError: It is neither a known name nor a readable camera file.
    """
    return find_camera(args.camera) if args.camera else None
