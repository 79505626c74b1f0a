"""Text files in the TUM RGB-D format, such as trajectories: a stamp in s and values per line."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.io.stamps import format_stamp_s, in_order, parse_stamp_ns
from hoid_common.io.untrusted import read_text
from hoid_common.sync import RESTART_NS
from hoid_common.values import FloatArray, IntArray, Trajectory

_LOG = logging.getLogger(__name__)
# Chosen: a quaternion is refused if its norm is below this value or above its reciprocal.
# Published files round quaternions to four decimals, which changes the norm much less.
_MIN_QUATERNION_NORM = 0.5


class Row(NamedTuple):
    """One line of a TUM text file."""

    line: int  # number of the line in the file, from 1
    stamp_ns: int
    text: str  # the rest of the line, in which spaces replace commas and tabs


class NumberTable(NamedTuple):
    """N stamped rows of numbers."""

    stamps_ns: IntArray  # (N,)
    values: FloatArray  # (N, columns)


def read_rows(path: Path) -> Iterator[Row]:
    """Yield the rows of a file; InputError if it is not text, or a line has no valid stamp."""
    for number, stamp, rest in _lines(path):
        try:
            yield Row(number, parse_stamp_ns(stamp), rest)
        except ValueError as error:
            raise InputError(f'{path}: line {number}: {error}') from error


def sorted_rows(path: Path) -> list[Row]:
    """Return the rows in order of time, each stamp once; log a warning if rows were changed."""
    rows = list(read_rows(path))
    order = in_order([row.stamp_ns for row in rows])
    if text := str(order):
        _LOG.warning('%s: %s', path, text)
    return [rows[i] for i in order.positions.tolist()]


def read_numbers(
    path: Path,
    columns: int,
    problem: Callable[[FloatArray], str | None] = lambda _: None,
    *,
    is_finite: bool = True,
) -> NumberTable:
    """Return the stamp and the first `columns` numbers of each usable row, in order of time.

    Rows without valid stamp or numbers, and those for which `problem` returns a text, are left out
    with a warning: motion-capture systems write NaN or zeros while they do not see their target.
    InputError if there are rows, but none is usable.
    """
    stamps_ns: list[int] = []
    values: list[FloatArray] = []
    problems: list[str] = []
    for number, stamp, rest in _lines(path):
        try:
            stamp_ns, row = parse_stamp_ns(stamp), _numbers(rest, columns)
            if is_finite and not np.isfinite(row).all():
                raise ValueError(f'"{rest}" contains a number that is not finite')
            if text := problem(row):
                raise ValueError(text)
        except ValueError as error:
            problems.append(f'line {number}: {error}')
            continue
        stamps_ns.append(stamp_ns)
        values.append(row)
    if problems and not values:
        raise InputError(f'{path}: no row is usable; {problems[0]}')
    order = in_order(stamps_ns)
    left_out = f'{len(problems)} unusable rows left out ({problems[0]})' if problems else ''
    if text := ', '.join(filter(None, (left_out, str(order)))):
        _LOG.warning('%s: %s', path, text)
    return NumberTable(order.stamps_ns, np.array(values).reshape(-1, columns)[order.positions])


def _numbers(text: str, columns: int) -> FloatArray:
    words = text.split()[:columns]
    try:
        row = np.array([float(word) for word in words])
    except ValueError:
        row = np.empty(0)
    if len(row) < columns:
        raise ValueError(f'not {columns} numbers after the stamp: "{text}"')
    return row


def _lines(path: Path) -> Iterator[tuple[int, str, str]]:
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        stamp, _, rest = line.strip().replace(',', ' ').replace('\t', ' ').partition(' ')
        if stamp and not stamp.startswith('#'):
            yield number, stamp, rest.strip()


def read_tum(path: Path) -> Trajectory:
    """Return the poses in a TUM file in order of time, each stamp once; it may be empty.

    Rows that are no valid pose are left out with a warning. InputError if there are rows, but no
    valid pose.
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
    """Counts of the poses that were written to a trajectory file or left out."""

    num_written: int
    num_earlier: int  # left out: poses from before the stamps started anew
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

    Only the poses after the last restart of time are kept, because evo and other tools refuse
    decreasing stamps. Only one part is in memory at a time. OSError if writing fails.
    """
    num_written = num_earlier = num_repeated = newest_ns = 0
    with path.open('w', encoding='utf-8') as file:
        file.write('# timestamp tx ty tz qx qy qz qw\n')
        start = file.tell()
        for stamp_ns, line in (pose for part in parts for pose in _pose_lines(part)):
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


def _pose_lines(trajectory: Trajectory) -> Iterator[tuple[int, str]]:
    quats_xyzw = se3.quat_xyzw_from_rotation(trajectory.T_world_camera[:, :3, :3])
    rows = np.hstack([trajectory.T_world_camera[:, :3, 3], quats_xyzw])
    for stamp_ns, row in zip(trajectory.stamps_ns.tolist(), rows.tolist(), strict=True):
        values = ' '.join(f'{value:.9f}' for value in row)
        yield stamp_ns, f'{format_stamp_s(stamp_ns)} {values}\n'
