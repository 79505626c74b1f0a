"""Trajectories as TUM text: lines `stamp tx ty tz qx qy qz qw`, in s, m and a quaternion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.io.stamps import format_stamp_s
from hoid_common.io.tum_text import read_numbers
from hoid_common.sync import RESTART_NS
from hoid_common.values import FloatArray, Trajectory

# Chosen: a quaternion with a norm below this or above its inverse is refused. Published files
# round quaternions to four decimals, which changes the norm much less.
_MIN_QUATERNION_NORM = 0.5


def read_tum(path: Path) -> Trajectory:
    """Return the poses in a TUM file in order of time, each stamp once; it may be empty.

    Rows that are no pose are left out with a warning. InputError if there are rows, and none is a
    pose.
    """
    stamps_ns, values = read_numbers(path, 7, _pose_problem)
    return Trajectory(stamps_ns, se3.from_quat_translation(values[:, 3:], values[:, :3]))


def _pose_problem(row: FloatArray) -> str | None:
    norm = float(np.linalg.norm(row[3:]))
    is_rotation = _MIN_QUATERNION_NORM <= norm <= 1 / _MIN_QUATERNION_NORM
    return None if is_rotation else f"the quaternion's norm is {norm:.3g}, not 1"


def write_tum(path: Path, trajectory: Trajectory) -> None:
    write_tum_parts(path, [trajectory])


class WrittenPoses(NamedTuple):
    """Numbers of poses of a trajectory file."""

    num_written: int
    num_earlier: int  # left out: poses from before time started anew
    num_repeated: int  # left out: poses whose stamp is not later than the one before

    def __str__(self) -> str:
        text = f'{self.num_written} poses'
        if self.num_earlier:
            text += f' since time started anew ({self.num_earlier} earlier ones left out)'
        if self.num_repeated:
            text += f' ({self.num_repeated} with a repeated or older stamp left out)'
        return text


def write_tum_parts(path: Path, parts: Iterable[Trajectory]) -> WrittenPoses:
    """Write consecutive parts of a trajectory as a TUM file with increasing stamps.

    Only poses since stamps started anew last are written, because evo and other tools refuse other
    files, and only one part at a time is in memory. OSError if the file cannot be written.
    """
    num_written = num_earlier = num_repeated = newest_ns = 0
    with path.open('w', encoding='utf-8') as file:
        file.write('# timestamp tx ty tz qx qy qz qw\n')
        start = file.tell()
        for stamp_ns, line in (pose for part in parts for pose in _lines(part)):
            if num_written and newest_ns - stamp_ns >= RESTART_NS:
                file.seek(start)
                file.truncate()
                num_earlier, num_written = num_earlier + num_written, 0
            if num_written and stamp_ns <= newest_ns:
                num_repeated += 1
                continue
            file.write(line)
            newest_ns, num_written = stamp_ns, num_written + 1
    return WrittenPoses(num_written, num_earlier, num_repeated)


def _lines(trajectory: Trajectory) -> Iterator[tuple[int, str]]:
    quats_xyzw = se3.quat_xyzw_from_rotation(trajectory.T_world_camera[:, :3, :3])
    rows = np.hstack([trajectory.T_world_camera[:, :3, 3], quats_xyzw])
    for stamp_ns, row in zip(trajectory.stamps_ns.tolist(), rows.tolist(), strict=True):
        values = ' '.join(f'{value:.9f}' for value in row)
        yield stamp_ns, f'{format_stamp_s(stamp_ns)} {values}\n'
