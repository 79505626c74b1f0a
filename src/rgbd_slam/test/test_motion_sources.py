"""Motion sources predict the motion since the last tracked frame."""

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.slam_status import SlamState
from hoid_common.values import S_PER_NS, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.slam import RgbdSlam
from rgbd_slam.tracking.motion_sources import BridgedMotion
from rgbd_slam.tracking.odometry import Odometry

from .world import CAMERA, PERIOD_NS, World, tracked_at

TWIST: FloatArray = np.array([0.6, -0.3, 0.9, 0.3, 0.6, -0.15])  # rad/s, m/s
MS = 1_000_000


def predicted(elapsed_ns: int, twist: FloatArray = TWIST) -> FloatArray:
    """Return the motion that the last velocity predicts for an elapsed time."""
    odometry = Odometry(Atlas(1.2, 8))
    odometry.restart_from(tracked_at(np.eye(4), 0))
    odometry.twist = twist
    odometry.follow(elapsed_ns)
    return odometry.predict()[0]


@pytest.mark.parametrize('steps', [1, 2, 3])
def test_the_predicted_motion_is_proportional_to_time(steps: int) -> None:
    step = se3.exp(S_PER_NS * 33 * MS * TWIST)
    expected = np.linalg.matrix_power(step, steps)
    np.testing.assert_allclose(predicted(steps * 33 * MS), expected, atol=1e-9)


def test_no_motion_is_predicted_without_a_velocity() -> None:
    odometry = Odometry(Atlas(1.2, 8))
    odometry.restart_from(tracked_at(np.eye(4), 0))
    odometry.follow(33 * MS)
    np.testing.assert_array_equal(odometry.predict()[0], np.eye(4))
    odometry.twist = TWIST
    assert not np.array_equal(odometry.predict()[0], np.eye(4))
    odometry.forget_velocity()
    np.testing.assert_array_equal(odometry.predict()[0], np.eye(4))


def test_predictions_are_limited_in_time() -> None:
    np.testing.assert_allclose(predicted(10_000 * MS), predicted(250 * MS))
    np.testing.assert_array_equal(predicted(-MS), np.eye(4))


class _Gyroscope:
    """Another motion source, as a package may add it: it knows a sudden motion in advance."""

    T_camera_last: FloatArray = se3.exp(np.array([0.0, -0.25, 0, -0.4, 0, 0]))

    def start(self, stamp_ns: int) -> None:
        pass

    def advance(self, stamp_ns: int) -> None:
        pass

    def observe(self, T_last_camera: FloatArray) -> None:
        pass

    def predict(self) -> FloatArray:
        return self.T_camera_last

    def bridge(self) -> BridgedMotion | None:
        return None


def test_a_further_source_is_handed_to_the_slam() -> None:
    """With its prediction, a sudden motion is tracked that otherwise needs relocalization."""
    for sources in ([], [_Gyroscope()]):
        slam, world = RgbdSlam(CAMERA, SlamConfig(), motion_sources=sources), World()
        for n, T in enumerate([np.eye(4)] * 3 + [se3.inverse(_Gyroscope.T_camera_last)]):
            result = slam.process(world.features(n * PERIOD_NS, T))
            assert result.state is SlamState.TRACKING
        assert slam.stats.num_relocalizations == (0 if sources else 1)
