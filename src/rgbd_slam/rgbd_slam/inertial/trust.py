"""Decision which sensors of an IMU are used, from their samples and the tracked motion."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

import numpy as np

from hoid_common.values import NS_PER_S
from rgbd_slam.inertial.gyro_calibration import GyroFit
from rgbd_slam.inertial.sample_buffer import SampleBuffer, Samples

# Chosen: larger than any driver's delay and the time offsets that are estimated.
_LATE_NS = NS_PER_S // 4
_EQUAL_SAMPLES = 20  # chosen: fewer equal samples in a row may be a coincidence of coarse sensors
_SATURATED_RADPS = 0.9  # chosen: equal rates above this are at the limit of the sensor's range
# Chosen: noise makes this many equal samples unlikely, except at the limit of the range.
_SATURATED_SAMPLES = 4
_UNIT_TOLERANCE = 1.5  # chosen: the unit is deg/s if the scale is 180 / pi up to this factor
# Chosen: with less correlation, the rates are not the camera's rates in another unit.
_MIN_CORRELATION = 0.7
_MIN_SIGNAL_RADPS = 0.1  # chosen: slower tracked rates are mostly noise
_DOUBTED_SIGNAL_RADPS = 0.05  # chosen: tracked rates above this should confirm a gyro within 10 s
# Chosen: largest ratio of the tracked rates that a good gyro does not explain.
_MAX_UNEXPLAINED = 0.8
# Chosen: the mounting of the gyro counts as known if its rates correlate with the tracked ones by
# more than this: the first number if the rotation is the given one or parallel to the optical
# axes, the second if it was estimated from the images alone. When a moving scene misleads the
# tracking of `d435_office`, a mirrored gyro reaches 0.73 with some rotation.
_EXPECTED_CORRELATION, _FOUND_CORRELATION = 0.6, 0.85
# Chosen: before the accelerometer has been compared with tracked positions, the map is leveled
# only if the standard deviation of the direction of gravity is below this. On calm cameras it is
# 1.1 to 1.2 degrees after 1.5 s, and 2.0 to 4.4 if the accelerometer's axes are permuted.
_UNTRIED_SIGMA_RAD = np.deg2rad(1.5)
# Chosen: an accelerometer is not used if the RMS error of dead reckoning is larger, in standard
# deviations. Good ones have 0.3 to 1.3; faulty ones have 3 and more while the camera moves.
_MAX_TRIAL_ERROR = 2.0
_PATIENCE_NS = 10 * NS_PER_S  # chosen: disagreement is reported after this time
_LEFT_OUT = 'imu: the gyro is left out: {}'
_BOTH_LEFT_OUT = f'{_LEFT_OUT}; so is the accelerometer, because it has the same clock'
_CONTRADICTS = (
    'imu: the accelerometer is left out, because it does not agree with the tracked motion; check '
    'its axes and stamps, or turn the camera more slowly'
)
_STUCK_ACCELEROMETER = (
    'imu: the accelerometer is left out: its values do not change; restart its driver'
)


class GyroFault(Enum):
    """Why a gyro is not used; the value is a text that also says what to do."""

    STUCK = 'its values do not change; restart its driver'
    LATE = 'its samples are more than 0.25 s late or have stopped; check its driver and its clock'
    UNIT = 'its rates are in degrees per second instead of radians per second; correct its driver'
    MIRRORED = 'one of its axes points the wrong way (a left-handed frame); correct its driver'
    DISAGREES = 'it contradicts the rotation that the images show; check its unit, axes and clock'
    UNPROVEN = (
        'for 10 s, the images have not confirmed it; check its axes and clock, turn the camera in '
        'all directions, or set imu.calibration'
    )


class News(NamedTuple):
    """A message about the IMU."""

    text: str
    is_problem: bool


class Trust:
    """Decides whether a gyro and an accelerometer with the same clock may be used."""

    def __init__(self) -> None:
        # Whether accelerometer and tracked motion agree; None: not tried.
        self.agrees: bool | None = None
        self.has_accelerometer = False
        self._gyro: SampleBuffer | None = None  # None: there is no gyro
        self._fault_of_samples: GyroFault | None = None
        self._fault_of_fit: GyroFault | None = None
        self._is_mounting_known = False
        self._is_accelerometer_stuck = False
        self._since_ns: dict[str, int] = {}  # by sensor: stamp since which it has been doubted
        self._now_ns = 0  # stamp of the image of the last comparison
        self._said: dict[str, News] = {}  # all messages by their kind
        self._num_taken = 0  # messages that `take_news` has returned

    @property
    def fault(self) -> GyroFault | None:
        """Return the fault because of which the gyro is not used; None: it has no fault."""
        return self._fault_of_samples or self._fault_of_fit

    @property
    def uses_gyro(self) -> bool:
        """Return whether the images have confirmed the gyro's mounting, and it has no fault."""
        return self._gyro is not None and self._is_mounting_known and self.fault is None

    @property
    def uses_accelerometer(self) -> bool:
        """Return whether neither the accelerometer nor the clock of the gyro has a fault."""
        return not self._is_accelerometer_stuck and (self._gyro is None or self.uses_gyro)

    def may_level(self, up_sigma_rad: float) -> bool:
        """Return whether gravity is accurate and confirmed enough to level the map."""
        is_right = up_sigma_rad < _UNTRIED_SIGMA_RAD if self.agrees is None else self.agrees
        return self.uses_accelerometer and is_right

    @property
    def in_use(self) -> str:
        """Return the names of the sensors that are in use, or 'none'."""
        is_tried = self.has_accelerometer and self.uses_accelerometer and self.agrees
        used = {'gyro': self.uses_gyro, 'accelerometer': is_tried}
        return ', '.join(name for name, is_used in used.items() if is_used) or 'none'

    @property
    def problem(self) -> str:
        """Return a text about the sensor that is not used and the reason, or ''."""
        if self.fault is not None:
            text = _BOTH_LEFT_OUT if self.has_accelerometer else _LEFT_OUT
            return text.format(self.fault.value)
        if self._is_accelerometer_stuck:
            return _STUCK_ACCELEROMETER
        return _CONTRADICTS if self._lasts('accelerometer') else ''

    def compare_samples(self, gyro: SampleBuffer, image_ns: int, offset_ns: int) -> bool:
        """Return whether the samples of the gyro arrive in time, and their values change."""
        self._gyro, self._now_ns, self._fault_of_samples = gyro, image_ns, None
        latest = gyro.before(image_ns + offset_ns, 1)
        if not len(latest) or latest.stamps_ns[0] < image_ns + offset_ns - _LATE_NS:
            self._fault_of_samples = GyroFault.LATE
        elif is_stuck(gyro, image_ns + offset_ns):
            self._fault_of_samples = GyroFault.STUCK
        return self._fault_of_samples is None

    def compare_rates(self, fit: GyroFit, recent: GyroFit | None) -> bool:
        """Return whether the comparison with tracked rotations reveals no fault of the gyro.

        No fault is found while the camera hardly turns. `recent`, the comparison over the last 2
        s, is only used to detect rates in degrees, because in blurred images the tracked rotation
        may be wrong too.
        """
        self._fault_of_fit = _fault_of(fit)
        if recent is not None and _is_in_degrees(recent):
            self._fault_of_fit = GyroFault.UNIT
        return self._fault_of_fit is None

    def compare_axes(self, fit: GyroFit, *, is_expected: bool, is_certain: bool) -> None:
        """Confirm the mounting of a faultless gyro if its rates correlate with the tracked ones.

        Args:
            fit: The fit with the rotation to the camera that is used.
            is_expected: Whether this rotation is the given one or the identity.
            is_certain: Whether this rotation is given or accurate enough.
        """
        needed = _EXPECTED_CORRELATION if is_expected else _FOUND_CORRELATION
        self._is_mounting_known |= bool(is_certain and fit.correlation > needed)
        is_turning = fit.signal_radps > _DOUBTED_SIGNAL_RADPS
        self._note('gyro', is_doubted=is_turning and not self._is_mounting_known)
        if self._lasts('gyro'):
            self._fault_of_fit = GyroFault.UNPROVEN

    def compare_forces(self, accelerometer: SampleBuffer, image_ns: int) -> bool:
        """Return whether the accelerometer has no known fault, so that it can be compared."""
        self.has_accelerometer, self._now_ns = True, image_ns
        newest_ns = accelerometer.newest_ns
        self._is_accelerometer_stuck = newest_ns is not None and is_stuck(accelerometer, newest_ns)
        return self.uses_accelerometer

    def compare_positions(self, trial_error: float | None) -> None:
        """Store whether the accelerometer agrees with the tracked positions.

        `trial_error` is the error of dead reckoning in the last seconds (`Path.trial_error`).
        """
        self.agrees = None if trial_error is None else trial_error <= _MAX_TRIAL_ERROR
        self._note('accelerometer', is_doubted=self.agrees is False)

    def report(self) -> None:
        """Store a present problem for `take_news`; called after a comparison."""
        if self.problem:
            self.say(self.problem)

    def say(self, text: str, kind: str = '', *, is_problem: bool = True) -> None:
        """Store a message for `take_news`, once for each `kind` (default: the text itself)."""
        self._said.setdefault(kind or text, News(text, is_problem))

    @property
    def problems(self) -> tuple[str, ...]:
        """Return the texts of all problems that were stored."""
        return tuple(news.text for news in self._said.values() if news.is_problem)

    def take_news(self) -> list[News]:
        """Return the messages that were stored since the last call."""
        news = list(self._said.values())[self._num_taken :]
        self._num_taken = len(self._said)
        return news

    def _note(self, sensor: str, *, is_doubted: bool) -> None:
        """Store the stamp since which a sensor has been doubted without interruption."""
        since_ns = self._since_ns.get(sensor, self._now_ns)
        if not is_doubted or since_ns > self._now_ns:
            self._since_ns.pop(sensor, None)
        else:
            self._since_ns[sensor] = since_ns

    def _lasts(self, sensor: str) -> bool:
        return self._now_ns - self._since_ns.get(sensor, self._now_ns) >= _PATIENCE_NS


def is_stuck(sensor: SampleBuffer, stamp_ns: int) -> bool:
    """Return whether the last 20 samples up to a time are equal; noise prevents that."""
    latest = sensor.before(stamp_ns, _EQUAL_SAMPLES).values
    return len(latest) == _EQUAL_SAMPLES and bool((latest == latest[0]).all())


def is_saturated(samples: Samples) -> bool:
    """Return whether four successive rates above 0.9 rad/s about one axis are equal."""
    values = samples.values
    if len(values) < _SATURATED_SAMPLES:
        return False
    repeats = (values[1:] == values[:-1]) & (np.abs(values[1:]) > _SATURATED_RADPS)
    runs = np.lib.stride_tricks.sliding_window_view(repeats, _SATURATED_SAMPLES - 1, axis=0)
    return bool(runs.all(axis=-1).any())


def _fault_of(fit: GyroFit) -> GyroFault | None:
    if fit.signal_radps < _MIN_SIGNAL_RADPS:
        return None
    if fit.is_mirrored:
        return GyroFault.MIRRORED
    if _is_in_degrees(fit):
        return GyroFault.UNIT
    is_explained = fit.residual_radps <= _MAX_UNEXPLAINED * fit.signal_radps
    return None if is_explained else GyroFault.DISAGREES


def _is_in_degrees(fit: GyroFit) -> bool:
    in_degrees = np.rad2deg(1.0) * fit.scale
    is_like = 1 / _UNIT_TOLERANCE < in_degrees < _UNIT_TOLERANCE
    return fit.signal_radps > _MIN_SIGNAL_RADPS and fit.correlation > _MIN_CORRELATION and is_like
