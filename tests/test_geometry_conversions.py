"""Round trips of poses and odometry, with messages that are serialized as by ROS."""

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


# Turns by up to 180 degrees about each axis make each component of the quaternion the largest.
@given(arrays(np.float64, 3, elements=st.floats(-np.pi, np.pi)))
def test_the_quaternion_of_one_pose_is_that_of_many(rotation: FloatArray) -> None:
    T = se3.exp(np.array([*rotation, 0, 0, 0]))
    q = conversions.pose_to_msg(T).orientation
    expected = se3.quat_xyzw_from_rotation(T[:3, :3])
    np.testing.assert_allclose([q.x, q.y, q.z, q.w], expected, rtol=0, atol=1e-15)


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
    np.testing.assert_allclose(conversions.pose_from_msg(msg.pose.pose), T, atol=1e-12)
    order = [3, 4, 5, 0, 1, 2]  # rotation first, as in the suite
    of_pose = np.reshape(msg.pose.covariance, (6, 6))[np.ix_(order, order)]
    A = np.kron(np.eye(2), T[:3, :3])
    np.testing.assert_allclose(A.T @ of_pose @ A, root @ root.T, atol=1e-9)
    w, v = msg.twist.twist.angular, msg.twist.twist.linear
    assert [w.x, w.y, w.z, v.x, v.y, v.z] == twist.tolist()


def test_covariances_have_the_order_and_axes_of_ros() -> None:
    # The base faces along the y axis of odom; its own x and its yaw are uncertain.
    T = se3.exp(np.array([0, 0, np.pi / 2, 0, 0, 0]))
    covariance = np.diag([0, 0, 0.03, 0.5, 0, 0])
    of_twist = np.diag([1.0, 2, 3, 4, 5, 6])
    msg = conversions.odometry_to_msg(T, covariance, np.arange(6.0), of_twist, HEADER, 'base')
    np.testing.assert_allclose(
        np.diag(np.reshape(msg.pose.covariance, (6, 6))), [0, 0.5, 0, 0, 0, 0.03], atol=1e-15
    )
    assert np.diag(np.reshape(msg.twist.covariance, (6, 6))).tolist() == [4, 5, 6, 1, 2, 3]
    assert (msg.twist.twist.angular.z, msg.twist.twist.linear.x) == (2.0, 3.0)
