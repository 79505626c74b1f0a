"""Reading and writing of trajectories in the TUM text format.

Each line is `stamp tx ty tz qx qy qz qw`: seconds, meters, and a quaternion.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.io.stamps import format_stamp_s
from hoid_common.io.tum_text import read_numbers
from hoid_common.values import Trajectory

# Chosen: published files round quaternions to four decimals; a norm below this is no rounding.
_MIN_QUATERNION_NORM = 0.5


def read_tum(path: Path) -> Trajectory:
    """Return the trajectory in a TUM file; it may be empty.

    Raises:
        InputError: The file is missing, or a row is malformed or goes back in time.
    """
    stamps_ns, values = read_numbers(path, columns=7)
    norms = np.linalg.norm(values[:, 3:], axis=1)
    wrong = np.flatnonzero((norms < _MIN_QUATERNION_NORM) | (norms > 1 / _MIN_QUATERNION_NORM))
    if len(wrong):
        raise InputError(
            f"{path}: pose {wrong[0] + 1}: the quaternion's norm is {norms[wrong[0]]:.3g}, not 1"
        )
    return Trajectory(stamps_ns, se3.from_quat_translation(values[:, 3:], values[:, :3]))


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory as a TUM file; stamps are exact, numbers have nine decimals."""
    write_tum_parts(path, [trajectory])


def write_tum_parts(path: Path, parts: Iterable[Trajectory]) -> int:
    """Write consecutive parts of a trajectory as a TUM file, and return the number of poses.

    Only one part at a time is in memory.
    """
    num_poses = 0
    with path.open('w', encoding='utf-8') as file:
        file.write('# timestamp tx ty tz qx qy qz qw\n')
        for part in parts:
            file.writelines(_lines(part))
            num_poses += len(part)
    return num_poses


def _lines(trajectory: Trajectory) -> Iterator[str]:
    quats_xyzw = se3.quat_xyzw_from_rotation(trajectory.T_world_camera[:, :3, :3])
    rows = np.hstack([trajectory.T_world_camera[:, :3, 3], quats_xyzw])
    for stamp_ns, row in zip(trajectory.stamps_ns.tolist(), rows.tolist(), strict=True):
        yield f'{format_stamp_s(stamp_ns)} {" ".join(f"{value:.9f}" for value in row)}\n'
