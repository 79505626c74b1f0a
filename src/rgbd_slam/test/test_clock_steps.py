"""Steps of the clock that stamps images and an IMU: tracking goes on, and takes no longer."""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np
import pytest

from hoid_common.slam_status import SlamState
from hoid_common.values import NS_PER_S, S_PER_NS
from rgbd_slam.config.imu_config import ImuConfig
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.inertial.imu import Imu
from rgbd_slam.inertial.sample_buffer import Samples
from rgbd_slam.slam import RgbdSlam

from .shaken_imu import IMAGE_NS, IMU_NS, force, pose, rate
from .world import CAMERA, World

HOUR_NS, DECADE_NS = 3600 * NS_PER_S, 10 * 8766 * 3600 * NS_PER_S
START_NS = 2 * DECADE_NS
NUM_BEFORE, NUM_AFTER = 50, 20


@pytest.mark.parametrize('step_ns', [HOUR_NS, -HOUR_NS, DECADE_NS, -DECADE_NS])
@pytest.mark.parametrize('of_images', [True, False], ids=['both clocks', 'clock of the imu'])
def test_after_a_clock_step_the_next_image_is_tracked_in_the_usual_time(
    step_ns: int, of_images: bool
) -> None:
    imu, world = Imu(ImuConfig()), World()
    slam = RgbdSlam(CAMERA, SlamConfig(), imu=imu)
    needed_s, states = [], []
    for k in range(NUM_BEFORE + NUM_AFTER):
        step = step_ns if k >= NUM_BEFORE else 0
        times_ns = np.arange(k * IMAGE_NS, (k + 1) * IMAGE_NS, IMU_NS)
        times_s = (S_PER_NS * times_ns).tolist()
        stamps_ns = START_NS + step + times_ns
        imu.add_rates(Samples(stamps_ns, np.array([rate(s) for s in times_s])))
        imu.add_accelerations(Samples(stamps_ns, np.array([force(s) for s in times_s])))
        stamp_ns = START_NS + k * IMAGE_NS + (step if of_images else 0)
        features = world.features(stamp_ns, pose(S_PER_NS * k * IMAGE_NS))
        start_s = time.thread_time()
        states.append(slam.process(features).state)
        needed_s.append(time.thread_time() - start_s)
    assert states == [SlamState.TRACKING] * (NUM_BEFORE + NUM_AFTER)
    assert max(needed_s[NUM_BEFORE:]) < 3 * max(needed_s[5:NUM_BEFORE])
    stamps_ns = slam.trajectory.online().stamps_ns.tolist()
    assert len(stamps_ns) == NUM_BEFORE + NUM_AFTER
    steps_ns = [second - first - IMAGE_NS for first, second in pairwise(stamps_ns)]
    assert [s for s in steps_ns if s] == ([step_ns] if of_images else [])
