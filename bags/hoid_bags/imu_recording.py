"""The samples of an IMU in a text file or in a topic of a bag."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import reduce
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_bags.bag.bag_reader import BagReader, is_bag
from hoid_bags.storage import bag_types as types
from hoid_bags.tum.layouts import TUM, find_layout
from hoid_common import topics
from hoid_common.errors import InputError, MessageError, prefixed
from hoid_common.io.stamps import in_order
from hoid_common.io.tum_text import NumberTable, read_numbers, read_rows
from hoid_common.io.untrusted import read_text
from hoid_common.messages import ImuSample, imu_from_msg

# Chosen: unless names show which sensor it is, a sensor is an accelerometer if the length of its
# median vector is between these [m/s^2], and a gyro otherwise. No camera turns at 7 rad/s for a
# whole recording.
_GRAVITY_MPS2 = 7.0, 12.0
_ACCELEROMETER_WORDS = ('accel', 'ax ay az')
_GYRO_WORDS = ('gyro', 'wx wy wz')
_HEAD_CHARS = 500  # chosen: characters at the start of a file that are searched for comments


class ImuRecording(NamedTuple):
    """The samples of an IMU along its own axes."""

    rates: NumberTable | None = None  # (N, 3) rad/s; None: there is no gyro
    accelerations: NumberTable | None = None  # (N, 3) m/s^2; None: there is no accelerometer

    def joined(self, other: ImuRecording) -> ImuRecording:
        """Return the samples of both; for a sensor that both have, those of `self`."""
        return ImuRecording(
            self.rates if self.rates is not None else other.rates,
            self.accelerations if self.accelerations is not None else other.accelerations,
        )


def joined_imu(names: Sequence[str], recording: Path) -> ImuRecording:
    """Return the samples of files and topics (see `read_imu`) as those of one IMU."""
    found = (read_imu(name, recording) for name in names)
    return reduce(ImuRecording.joined, found, ImuRecording())


def read_imu(name: str, recording: Path) -> ImuRecording:
    """Return the samples of a text file or, if no file has this name, of a topic of a bag."""
    if is_bag(recording) and not Path(name).is_file():
        return read_imu_topic(recording, name)
    return read_imu_file(Path(name))


def read_own_imu(recording: Path) -> ImuRecording:
    """Return the samples of a recording's IMU under the usual names; InputError if there is none.

    These are the topics `imu` and `imu/accelerometer` of a bag, and the files of a folder's
    layout, such as `gyro.txt`. If both contain the same sensor, the first one is used.
    """
    if is_bag(recording):
        with BagReader(recording) as reader:
            own = {item.name for item in reader.topics if item.type_name == types.IMU}
        names = [name for name in (topics.IMU, topics.ACCELEROMETER) if f'/{name}' in own]
        found = joined_imu(names, recording)
    else:
        found = ImuRecording(*(find_layout(recording) or TUM).imu(recording))
    if found == ImuRecording():
        raise InputError(f'{recording}: has no samples of an IMU')
    return found


def read_imu_file(path: Path) -> ImuRecording:
    """Return the samples of a text file with a stamp in seconds and three or six numbers a line.

    Six numbers are wx wy wz [rad/s] and ax ay az [m/s^2]. Three are those of one sensor, as in
    TUM's `accelerometer.txt`. Comments at the start or the name of the file state which sensor; if
    they do not, the numbers are accelerations if their median has about the length of gravity. The
    first line decides between three and six; further numbers of a line are ignored. The samples
    are in order of time, each stamp once; rows without stamp or numbers are left out. InputError
    if the file cannot be read, the first stamp is no time, or no line is usable.
    """
    columns = next((min(len(row.text.split()), 6) for row in read_rows(path)), 0)
    if columns < 3:
        raise InputError(
            f'{path}: has no samples; expected lines of a stamp in seconds and wx wy wz (rad/s), '
            'ax ay az (m/s^2), or both'
        )
    if columns == 6:
        table = read_numbers(path, 6, is_finite=False)
        return ImuRecording(
            NumberTable(table.stamps_ns, table.values[:, :3]),
            NumberTable(table.stamps_ns, table.values[:, 3:]),
        )
    table = read_numbers(path, 3, is_finite=False)
    if _is_accelerometer(path, table):
        return ImuRecording(accelerations=table)
    return ImuRecording(rates=table)


def read_imu_topic(bag: Path, topic: str) -> ImuRecording:
    """Return the samples of a topic of sensor_msgs/Imu in order of time, each stamp once.

    InputError if the bag has no such topic, the topic has another type, a message is damaged, or
    there is no sample of either sensor.
    """
    topic = f'/{topic.lstrip("/")}'
    samples: list[ImuSample] = []
    with BagReader(bag) as reader:
        found = {item.name: item for item in reader.topics}.get(topic)
        if found is None or found.type_name != types.IMU:
            names = ', '.join(item.name for item in reader.topics if item.type_name == types.IMU)
            raise InputError(f'{bag}: no topic {topic} of {types.IMU}; it has {names or "none"}')
        for message in reader.messages([topic]):
            with prefixed(f'{bag}: {topic}: ', InputError, MessageError):
                msg = types.deserialize(message.data, types.IMU)
            with suppress(MessageError):  # the message has neither sensor
                samples.append(imu_from_msg(msg))
    if not samples:
        raise InputError(f'{bag}: {topic} has no rates and no accelerations')
    return ImuRecording(
        _table([(s.stamp_ns, s.rate_radps) for s in samples]),
        _table([(s.stamp_ns, s.acceleration_mps2) for s in samples]),
    )


def _table(rows: list[tuple[int, tuple[float, float, float] | None]]) -> NumberTable | None:
    known = [(stamp_ns, values) for stamp_ns, values in rows if values is not None]
    if not known:
        return None
    stamps_ns, values = zip(*known, strict=True)
    order = in_order(stamps_ns)
    return NumberTable(order.stamps_ns, np.array(values)[order.positions])


def _is_accelerometer(path: Path, table: NumberTable) -> bool:
    """Return whether the three columns of a file are accelerations and not angular velocities."""
    lines = read_text(path)[:_HEAD_CHARS].splitlines()
    head = ' '.join([path.name, *(line for line in lines if line.startswith('#'))]).lower()
    is_named = tuple(
        any(word in head for word in words) for words in (_ACCELEROMETER_WORDS, _GYRO_WORDS)
    )
    if is_named[0] != is_named[1]:
        return is_named[0]
    low, high = _GRAVITY_MPS2
    return bool(low < np.linalg.norm(np.nanmedian(table.values, axis=0)) < high)
