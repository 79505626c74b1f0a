"""Reading and writing of trajectories in the TUM text format.

Each line is `stamp tx ty tz qx qy qz qw`: seconds, meters, and a quaternion.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from hoid_common import se3
from hoid_common.io.stamps import format_stamp_s
from hoid_common.io.tum_text import read_numbers
from hoid_common.values import FloatArray, Trajectory

# Chosen: published files round quaternions to four decimals. A norm below this or above its inverse
# is not caused by rounding.
_MIN_QUATERNION_NORM = 0.5


def read_tum(path: Path) -> Trajectory:
    """Return the poses in a TUM file in order of time, each stamp once; it may be empty.

    Rows that are no pose are left out with a warning.

    Raises:
        InputError: The file is missing, or has rows and none of them is a pose.
    """
    stamps_ns, values = read_numbers(path, 7, _pose_problem)
    return Trajectory(stamps_ns, se3.from_quat_translation(values[:, 3:], values[:, :3]))


def _pose_problem(row: FloatArray) -> str | None:
    """Return what is wrong with a row of position and quaternion (7,), or None."""
    norm = float(np.linalg.norm(row[3:]))
    is_rotation = _MIN_QUATERNION_NORM <= norm <= 1 / _MIN_QUATERNION_NORM
    return None if is_rotation else f"the quaternion's norm is {norm:.3g}, not 1"


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
    """Yield the line of each pose."""
    quats_xyzw = se3.quat_xyzw_from_rotation(trajectory.T_world_camera[:, :3, :3])
    rows = np.hstack([trajectory.T_world_camera[:, :3, 3], quats_xyzw])
    for stamp_ns, row in zip(trajectory.stamps_ns.tolist(), rows.tolist(), strict=True):
        yield f'{format_stamp_s(stamp_ns)} {" ".join(f"{value:.9f}" for value in row)}\n'
