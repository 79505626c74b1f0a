"""The IMU of an offline run: recorded samples are added in step with the images."""

from __future__ import annotations

from hoid_bags.imu_recording import ImuRecording
from hoid_common.io.tum_text import NumberTable
from hoid_common.values import NS_PER_S
from rgbd_slam.config.imu_config import ImuConfig
from rgbd_slam.inertial.imu import Imu
from rgbd_slam.inertial.mounting import kalibr_mounting
from rgbd_slam.inertial.sample_buffer import Samples

# Chosen: samples up to this time after the stamp of an image are added before the image is
# processed. Live, features also arrive later than the IMU samples of the same time.
_AHEAD_NS = NS_PER_S // 10


class ImuFeed:
    """Adds the samples of a recording to an IMU in step with the images."""

    def __init__(self, recording: ImuRecording, config: ImuConfig) -> None:
        self.imu = Imu(config, kalibr_mounting(config))
        self._rates, self._accelerations = recording
        self._num_rates = self._num_accelerations = 0  # numbers of samples that have been added

    def advance(self, stamp_ns: int) -> None:
        """Add the samples with stamps before `stamp_ns` + 0.1 s that are not added yet."""
        end_ns = stamp_ns + _AHEAD_NS
        if self._rates is not None:
            samples, self._num_rates = _next(self._rates, self._num_rates, end_ns)
            self.imu.add_rates(samples)
        if self._accelerations is not None:
            samples, self._num_accelerations = _next(
                self._accelerations, self._num_accelerations, end_ns
            )
            self.imu.add_accelerations(samples)


def _next(table: NumberTable, first: int, end_ns: int) -> tuple[Samples, int]:
    """Return the samples from row `first` on with stamps before `end_ns`, and the next row."""
    end = max(int(table.stamps_ns.searchsorted(end_ns)), first)
    return Samples(table.stamps_ns[first:end], table.values[first:end]), end
