"""Changes and faults of the samples of an IMU, by name, for the experiments."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hoid_bags.imu_recording import ImuRecording
from hoid_common import se3
from hoid_common.errors import ConfigError
from hoid_common.io.tum_text import NumberTable
from hoid_common.values import NS_PER_S, S_PER_NS, FloatArray

NO_IMU = 'none'
"""Change that leaves out the IMU."""
_GYRO, _ACCELEROMETER, _BOTH = 'gyro', 'accelerometer', 'imu'
_MS = NS_PER_S // 1000
_FAULT_FROM_S = 2.0  # chosen: time after which a fault begins that is not there at first
_GRAVITY_MPS2 = 9.81
_RANGE = {_GYRO: 2.0, _ACCELEROMETER: 8.0}  # chosen: below what these cameras reach [rad/s, m/s^2]
_GAP_S, _GAP_EVERY_S = 0.3, 1.0

Change = Callable[[NumberTable, str], NumberTable]


def changed_imu(recording: ImuRecording, change: str, seed: int) -> ImuRecording | None:
    """Return the samples after a change such as `gyro stuck`; None for `none`.

    A change is a sensor (`gyro`, `accelerometer`, or `imu` for both) and the name of what is done
    to its samples. Several changes are separated by commas.

    Args:
        recording: The samples.
        change: The names; empty for no change.
        seed: Seed of the random rotation of `imu turned`.

    Raises:
        ConfigError: There is no such change.
    """
    if change == NO_IMU:
        return None
    rates, accelerations = recording
    for words in filter(None, change.split(', ')):
        sensor, _, name = words.partition(' ')
        change_of = _changes(seed).get(name)
        if sensor not in (_GYRO, _ACCELEROMETER, _BOTH) or change_of is None:
            raise ConfigError(f'no change "{words}" of an IMU: see {__name__}')
        if rates is not None and sensor in (_GYRO, _BOTH):
            rates = change_of(rates, _GYRO)
        if accelerations is not None and sensor in (_ACCELEROMETER, _BOTH):
            accelerations = change_of(accelerations, _ACCELEROMETER)
    return ImuRecording(rates, accelerations)


def late_ms(change: str) -> float:
    """Return the time by which a change delays the stamps of both sensors [ms]."""
    return sum(float(w.split()[2]) for w in change.split(', ') if w.startswith('imu late'))


def turned(change: str, seed: int) -> FloatArray:
    """Return the rotation R_turned_imu (3, 3) that a change applies to the samples."""
    return _rotation(seed) if 'imu turned' in change.split(', ') else np.eye(3)


def _rotation(seed: int) -> FloatArray:
    rotation_vector = np.random.default_rng([seed, 42]).normal(0, 1, 3)
    return se3.exp(np.append(rotation_vector, np.zeros(3)))[:3, :3]


def _changes(seed: int) -> dict[str, Change]:
    return {
        'stuck': lambda table, _: _valued(table, np.tile(table.values[0], (len(table.values), 1))),
        'stuck later': _stuck_later,
        'in degrees': lambda table, _: _valued(table, np.rad2deg(table.values)),
        'in g': lambda table, _: _valued(table, table.values / _GRAVITY_MPS2),
        'axes permuted': lambda table, _: _valued(table, table.values[:, [2, 0, 1]]),
        'mirrored': lambda table, _: _valued(table, table.values * [1, -1, 1]),
        'turned': lambda table, _: _valued(table, table.values @ _rotation(seed).T),
        'saturated': lambda table, of: _valued(
            table, np.clip(table.values, -_RANGE[of], _RANGE[of])
        ),
        'gaps': _gaps,
        **{f'late {ms} ms': _late(ms) for ms in (20, 70, 500)},
    }


def _valued(table: NumberTable, values: FloatArray) -> NumberTable:
    return NumberTable(table.stamps_ns, values)


def _late(ms: int) -> Change:
    return lambda table, _: NumberTable(table.stamps_ns + ms * _MS, table.values)


def _times_s(table: NumberTable) -> FloatArray:
    return np.asarray(S_PER_NS * (table.stamps_ns - table.stamps_ns[0]), np.float64)


def _stuck_later(table: NumberTable, _: str) -> NumberTable:
    is_stuck = _times_s(table) > _FAULT_FROM_S
    last = table.values[np.argmax(is_stuck)]
    return _valued(table, np.where(is_stuck[:, None], last, table.values))


def _gaps(table: NumberTable, _: str) -> NumberTable:
    is_kept = _times_s(table) % _GAP_EVERY_S >= _GAP_S
    return NumberTable(table.stamps_ns[is_kept], table.values[is_kept])
