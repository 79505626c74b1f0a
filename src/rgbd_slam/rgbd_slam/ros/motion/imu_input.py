"""The topics of an IMU, which is used if it publishes."""

from __future__ import annotations

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import Imu as ImuMsg

from hoid_common import topics
from hoid_common.inputs.input_config import BEST_EFFORT
from hoid_common.messages import imu_from_msg
from hoid_common.poses.frames import StaticFrames
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.inputs import Inputs
from rgbd_slam.config.imu_config import ImuConfig
from rgbd_slam.inertial.imu import Imu
from rgbd_slam.inertial.mounting import Mounting, kalibr_mounting
from rgbd_slam.inertial.sample_buffer import Samples

# Chosen: messages that may wait while an image is processed: 0.5 s at 400 Hz.
_QUEUE_LENGTH = 200
_MAX_ROWS = 4000  # chosen: limits the memory while no images arrive: 10 s at 400 Hz
_IMU = 'imu'  # name of the problem in the diagnostics

_Row = tuple[int, tuple[float, float, float]]


class ImuInput:
    """Collects the samples of an IMU between two images, and passes them to the session's `Imu`.

    A driver may publish gyro and accelerometer on `imu`, together or in separate messages, or the
    accelerometer on `imu/accelerometer`.
    """

    def __init__(
        self, node: Node, config: ImuConfig, static: StaticFrames, diagnostics: Diagnostics
    ) -> None:
        self._node, self._config, self._static = node, config, static
        self._diagnostics = diagnostics
        self._calibrated = kalibr_mounting(config)
        self._rates: list[_Row] = []
        self._accelerations: list[_Row] = []
        self._frame = ''  # frame of the newest message
        self._num_samples = 0
        self._imu: Imu | None = None

    def subscribe(self, inputs: Inputs) -> None:
        """Subscribe to the IMU topics, unless the parameters disable the IMU."""
        if self._config.gyro or self._config.level:
            for topic in (topics.IMU, topics.ACCELEROMETER):
                inputs.messages(
                    ImuMsg,
                    topic,
                    self._on_message,
                    'IMU messages',
                    reliability=BEST_EFFORT,
                    is_occasional=True,
                    queue_length=_QUEUE_LENGTH,
                )

    def start(self) -> Imu:
        """Create and return the IMU of a new session."""
        self._imu = Imu(self._config, self._calibrated)
        return self._imu

    def deliver(self, camera_frame: str) -> None:
        """Pass the collected samples and the mounting to the IMU, before an image is tracked."""
        imu = self._imu
        if imu is None or not (self._rates or self._accelerations):
            return
        if self._frame:
            T_camera_imu = self._static.find(camera_frame, self._frame)
            if T_camera_imu is not None:
                imu.mount(Mounting(T_camera_imu[:3, :3]))
        imu.add_rates(_samples(self._rates))
        imu.add_accelerations(_samples(self._accelerations))
        self._rates, self._accelerations = [], []

    def report(self) -> None:
        """Report faults in the diagnostics and log messages of the IMU, after an image."""
        imu = self._imu
        if imu is None or not self._num_samples:
            return
        self._diagnostics.set_count('IMU samples', self._num_samples)
        self._diagnostics.set_count('IMU samples left out', imu.num_impossible)
        self._diagnostics.set_value('IMU sensors in use', imu.trust.in_use)
        self._diagnostics.report_problem(_IMU, imu.trust.problem)
        if imu.fit is not None:
            self._diagnostics.set_value('IMU time offset', f'{1e3 * imu.fit.offset_s:.0f} ms')
        for text, is_problem in imu.trust.take_news():
            if text != imu.trust.problem:  # the diagnostics log the present problem themselves
                logger = self._node.get_logger()
                (logger.warning if is_problem else logger.info)(text)

    def _on_message(self, msg: ImuMsg) -> None:
        sample = imu_from_msg(msg)
        self._frame = msg.header.frame_id
        self._num_samples += 1
        if self._imu is None:  # there is no session yet
            return
        if sample.rate_radps is not None:
            self._rates.append((sample.stamp_ns, sample.rate_radps))
        if sample.acceleration_mps2 is not None:
            self._accelerations.append((sample.stamp_ns, sample.acceleration_mps2))
        del self._rates[:-_MAX_ROWS], self._accelerations[:-_MAX_ROWS]


def _samples(rows: list[_Row]) -> Samples:
    stamps_ns = np.array([stamp_ns for stamp_ns, _ in rows], np.int64)
    return Samples(stamps_ns, np.array([values for _, values in rows], np.float64).reshape(-1, 3))
