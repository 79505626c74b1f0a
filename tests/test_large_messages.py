"""Messages serialized from whole arrays equal those that rclpy makes of single elements."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point, PoseStamped, Quaternion
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Path
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from hoid_common import se3
from hoid_common.ros import conversions, qos
from hoid_common.ros.conversions.slam import keyframe_lines_m, keyframe_marker
from hoid_common.ros.large_messages.publisher import OnDemandPublisher
from hoid_common.ros.large_messages.serialized import (
    cloud_to_cdr,
    keyframes_to_cdr,
    path_to_cdr,
)
from hoid_common.values import ByteArray, FloatArray
from hoid_system_tests.probe import Probe
from hoid_system_tests.wire import sent

STAMP_NS = 1_305_031_102_175_304_000


def header(frame: str) -> Header:
    return conversions.header_to_msg(STAMP_NS, frame)


def poses(count: int) -> FloatArray:
    return se3.exp(np.random.default_rng(count).normal(size=(count, 6)))


def read(data: ByteArray, type_: type[Any]) -> Any:
    return deserialize_message(data.tobytes(), type_)


# Frame names of all lengths give all paddings of the first and of the later elements.
@given(st.integers(0, 5), st.text('ab/', max_size=17))
def test_a_path_has_every_pose_in_the_frame_of_its_header(count: int, frame: str) -> None:
    T_map_base = poses(count)
    stamps_ns = STAMP_NS + np.arange(count) * 33_333_333
    expected = Path(header=header(frame))
    for stamp_ns, T in zip(stamps_ns.tolist(), T_map_base, strict=True):
        pose = PoseStamped(header=conversions.header_to_msg(stamp_ns, frame))
        x, y, z, w = se3.quat_xyzw_from_rotation(T[:3, :3]).tolist()
        pose.pose = conversions.pose_to_msg(T)
        pose.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
        expected.poses.append(pose)
    assert read(path_to_cdr(stamps_ns, T_map_base, header(frame)), Path) == expected


@given(st.integers(0, 5), st.text('ab/', max_size=9))
def test_keyframes_are_lines_of_one_marker(count: int, frame: str) -> None:
    T_map_camera = poses(count)
    marker = keyframe_marker(header(frame), is_empty=count == 0)
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in keyframe_lines_m(T_map_camera).tolist()]
    found = read(keyframes_to_cdr(T_map_camera, header(frame)), MarkerArray)
    assert found == sent(MarkerArray(markers=[marker]))
    assert found.markers[0].action == (Marker.ADD if count else Marker.DELETE)
    assert len(found.markers[0].points) == 16 * count


@given(st.integers(0, 5), st.text('ab/', max_size=9), st.booleans(), st.booleans())
def test_a_cloud_equals_the_message_of_its_points(
    count: int, frame: str, colored: bool, labeled: bool
) -> None:
    rng = np.random.default_rng(count)
    points_m = rng.normal(size=(count, 3)).astype(np.float32)
    colors = rng.integers(0, 256, (count, 3), np.uint8) if colored else None
    labels = rng.integers(0, 9, count, np.uint32) if labeled else None
    cloud = conversions.Cloud(points_m, colors, labels)
    expected = conversions.cloud_to_msg(cloud, header(frame))
    assert read(cloud_to_cdr(cloud, header(frame)), PointCloud2) == expected


@pytest.mark.parametrize('name', ['map', 'robot_1/map'])
def test_a_serialized_message_arrives_and_changes_of_the_subscribers_are_reported(
    probe: Probe, name: str
) -> None:
    changes: list[bool] = []
    publisher = OnDemandPublisher(
        probe.node, Path, 'path', qos.LATCHED, lambda: changes.append(publisher.is_wanted)
    )
    assert not publisher.is_wanted
    paths = probe.collect(Path, 'path', qos.LATCHED, wait=False)
    probe.spin_until(lambda: changes == [True], 'no change of the subscribers', 10.0)
    publisher.publish(path_to_cdr(np.array([STAMP_NS]), np.eye(4)[None], header(name)))
    probe.spin_until(lambda: len(paths) == 1, 'no path', 10.0)
    publisher.publish(Path(header=header(name)))
    probe.spin_until(lambda: len(paths) == 2, 'no second path', 10.0)
    assert [len(path.poses) for path in paths] == [1, 0]
    assert paths[0].poses[0].header.frame_id == name
