"""Changes and faults of the samples of an IMU, by name, for the experiments."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hoid_bags.imu_recording import ImuRecording
from hoid_common import se3
from hoid_common.errors import ConfigError
from hoid_common.io.tum_text import NumberTable
from hoid_common.values import NS_PER_S, S_PER_NS, BoolArray, FloatArray

NO_IMU = 'none'
"""Change that leaves out the IMU."""
_GYRO, _ACCELEROMETER, _BOTH = 'gyro', 'accelerometer', 'imu'
_MS = NS_PER_S // 1000
_FAULT_FROM_S = 2.0  # chosen: time after which a fault begins that is not there at first
_BEFORE_MIDDLE_S = 0.3  # chosen: time before the middle, where images may be black, likewise
_BIAS = {_GYRO: 0.2, _ACCELEROMETER: 1.0}  # chosen: sudden, along each axis [rad/s, m/s^2]
_SPIKE = {_GYRO: 30.0, _ACCELEROMETER: 150.0}  # chosen: within the range of large sensors
_SPIKE_EVERY = 100  # samples
_TURNED_RAD = np.deg2rad(20.0)
_GRAVITY_MPS2 = 9.81
_RANGE = {_GYRO: 2.0, _ACCELEROMETER: 8.0}  # chosen: below what these cameras reach [rad/s, m/s^2]
_GAP_S, _GAP_EVERY_S = 0.3, 1.0
_LATE_MS = 20, 70, 100, 250, 400, 500, 1000, 2000, 10000
_STEPS_NS = {'an hour': 3600 * NS_PER_S, 'ten years': 10 * 8766 * 3600 * NS_PER_S}

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
        'turned by 20 degrees': lambda table, _: _valued(table, table.values @ _tilt().T),
        'spikes': _spikes,
        'stuck in the middle': _stuck_in_the_middle,
        'biased in the middle': _biased_in_the_middle,
        **{f'late {ms} ms': _late(ms) for ms in _LATE_MS},
        **{f'early {ms} ms': _late(-ms) for ms in _LATE_MS},
        **{f'clock steps by {name}': _stepped(ns) for name, ns in _STEPS_NS.items()},
        **{f'clock steps back by {name}': _stepped(-ns) for name, ns in _STEPS_NS.items()},
    }


def _valued(table: NumberTable, values: FloatArray) -> NumberTable:
    return NumberTable(table.stamps_ns, values)


def _late(ms: int) -> Change:
    return lambda table, _: NumberTable(table.stamps_ns + ms * _MS, table.values)


def _times_s(table: NumberTable) -> FloatArray:
    return np.asarray(S_PER_NS * (table.stamps_ns - table.stamps_ns[0]), np.float64)


def _stuck_later(table: NumberTable, _: str) -> NumberTable:
    return _stuck(table, _times_s(table) > _FAULT_FROM_S)


def _stuck_in_the_middle(table: NumberTable, _: str) -> NumberTable:
    return _stuck(table, _is_after_middle(table))


def _stuck(table: NumberTable, is_stuck: BoolArray) -> NumberTable:
    last = table.values[np.argmax(is_stuck)]
    return _valued(table, np.where(is_stuck[:, None], last, table.values))


def _biased_in_the_middle(table: NumberTable, sensor: str) -> NumberTable:
    return _valued(table, table.values + _BIAS[sensor] * _is_after_middle(table)[:, None])


def _is_after_middle(table: NumberTable) -> BoolArray:
    times_s = _times_s(table)
    return np.asarray(times_s > times_s[-1] / 2 - _BEFORE_MIDDLE_S)


def _spikes(table: NumberTable, sensor: str) -> NumberTable:
    is_spike = np.arange(len(table.values)) % _SPIKE_EVERY == 0
    return _valued(table, np.where(is_spike[:, None], _SPIKE[sensor], table.values))


def _stepped(step_ns: int) -> Change:
    """Return the change of a clock that steps after 2 s; the table stays in order of time."""

    def change(table: NumberTable, _: str) -> NumberTable:
        stamps_ns = table.stamps_ns + step_ns * (_times_s(table) > _FAULT_FROM_S)
        order = np.argsort(stamps_ns, kind='stable')
        return NumberTable(stamps_ns[order], table.values[order])

    return change


def _tilt() -> FloatArray:
    return se3.exp(np.array([0.6, 0.0, 0.8, 0.0, 0.0, 0.0]) * _TURNED_RAD)[:3, :3]


def _gaps(table: NumberTable, _: str) -> NumberTable:
    is_kept = _times_s(table) % _GAP_EVERY_S >= _GAP_S
    return NumberTable(table.stamps_ns[is_kept], table.values[is_kept])
