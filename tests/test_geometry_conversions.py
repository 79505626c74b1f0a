"""Poses, odometry and paths to real messages and back, through real serialisation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hoid_common import se3
from hoid_common.errors import MessageError
from hoid_common.ros import conversions
from hoid_common.values import FloatArray
from hoid_system_tests.wire import sent

HEADER = conversions.header_to_msg(1_305_031_102_160_407_123, 'camera')


motions = arrays(np.float64, 6, elements=st.floats(-3, 3)).map(se3.exp)


@given(motions)
def test_pose_and_transform_round_trip(T: FloatArray) -> None:
    np.testing.assert_allclose(
        conversions.pose_from_msg(sent(conversions.pose_to_msg(T))), T, atol=1e-12
    )
    msg = sent(conversions.transform_to_msg(T, 5, 'map', 'odom'))
    assert (msg.header.frame_id, msg.child_frame_id, msg.header.stamp.nanosec) == (
        'map',
        'odom',
        5,
    )
    np.testing.assert_allclose(conversions.transform_from_msg(msg), T, atol=1e-12)


def test_a_pose_without_rotation_is_refused() -> None:
    msg = conversions.pose_to_msg(np.eye(4))
    msg.orientation.w = 0.0
    with pytest.raises(MessageError, match='pose is no rigid transform'):
        conversions.pose_from_msg(msg)


@given(motions)
def test_odometry_round_trip(T: FloatArray) -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    twist = rng.normal(size=6)
    msg = sent(conversions.odometry_to_msg(T, root @ root.T, twist, np.eye(6), HEADER, 'base'))
    assert (msg.header, msg.child_frame_id) == (HEADER, 'base')
    back_T, back_covariance, back_twist = conversions.odometry_from_msg(msg)
    np.testing.assert_allclose(back_T, T, atol=1e-12)
    np.testing.assert_allclose(back_covariance, root @ root.T, atol=1e-9)
    np.testing.assert_array_equal(back_twist, twist)


def test_covariance_in_ros_order_and_axes() -> None:
    # The base looks along the odometry's y axis; it is unsure of its own x and of its yaw.
    T = se3.exp(np.array([0, 0, np.pi / 2, 0, 0, 0]))
    covariance = np.diag([0, 0, 0.03, 0.5, 0, 0])
    of_twist = np.diag([1.0, 2, 3, 4, 5, 6])
    msg = conversions.odometry_to_msg(T, covariance, np.arange(6.0), of_twist, HEADER, 'base')
    np.testing.assert_allclose(
        np.diag(np.reshape(msg.pose.covariance, (6, 6))), [0, 0.5, 0, 0, 0, 0.03], atol=1e-15
    )
    assert np.diag(np.reshape(msg.twist.covariance, (6, 6))).tolist() == [4, 5, 6, 1, 2, 3]
    assert (msg.twist.twist.angular.z, msg.twist.twist.linear.x) == (2.0, 3.0)


def test_path_round_trip() -> None:
    T = se3.exp(np.random.default_rng(0).normal(size=(5, 6)))
    stamps = np.arange(5) * 33_000_000 + 1_305_031_102_000_000_000
    msg = sent(conversions.path_to_msg(stamps, T, HEADER))
    assert msg.poses[3].header.frame_id == 'camera'
    back_stamps, back_T = conversions.path_from_msg(msg)
    np.testing.assert_array_equal(back_stamps, stamps)
    np.testing.assert_allclose(back_T, T, atol=1e-12)
