"""Constant velocity is a speed, not a step an image."""

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.tracking.motion import ConstantVelocity

STEP: FloatArray = se3.exp(np.array([0.02, -0.01, 0.03, 0.01, 0.02, -0.005]))
MS = 1_000_000


@pytest.mark.parametrize('steps', [1, 2, 3])
def test_a_gap_of_several_images_is_crossed_in_as_many_steps(steps: int) -> None:
    motion = ConstantVelocity()
    motion.observe(STEP, 33 * MS)
    expected = np.linalg.matrix_power(STEP, steps)
    np.testing.assert_allclose(motion.predict(steps * 33 * MS), expected, atol=1e-9)


def test_after_a_gap_the_next_image_is_as_near_as_ever() -> None:
    motion = ConstantVelocity()
    motion.observe(STEP @ STEP, 66 * MS)
    np.testing.assert_allclose(motion.predict(33 * MS), STEP, atol=1e-9)


def test_no_motion_is_expected_without_a_speed() -> None:
    motion = ConstantVelocity()
    np.testing.assert_array_equal(motion.predict(33 * MS), np.eye(4))
    motion.observe(STEP, 33 * MS)
    motion.forget()
    np.testing.assert_array_equal(motion.predict(33 * MS), np.eye(4))
    motion.observe(STEP, 33 * MS)
    motion.observe(STEP, 0)
    np.testing.assert_array_equal(motion.predict(33 * MS), np.eye(4))


def test_a_long_gap_and_a_stamp_that_goes_back_lead_nowhere_far() -> None:
    motion = ConstantVelocity()
    motion.observe(STEP, 33 * MS)
    np.testing.assert_allclose(motion.predict(10_000 * MS), motion.predict(250 * MS))
    np.testing.assert_array_equal(motion.predict(-MS), np.eye(4))
