"""rgbd_slam on real topics: known poses are recovered from exact features."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hoid_msgs.msg import Features as FeaturesMsg
from hoid_msgs.msg import SlamStatus
from hoid_msgs.srv import SaveTrajectory
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMsg
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from hoid_common import se3
from hoid_common.io.tum_text import read_tum
from hoid_common.ros import conversions, qos
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import FloatArray
from hoid_system_tests.frame_tree import OPTICAL, edges
from hoid_system_tests.point_world import PointWorld, pose_after
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.slam_peer import (
    PERIOD_NS,
    START_NS,
    SlamPeer,
    features_msg,
)


def camera_at(i: int) -> FloatArray:
    """Return the (4, 4) T_world_camera of image i."""
    return pose_after(i, turn_rad=0.004)


class Peer(SlamPeer):
    """Publishes the features of images of a point world."""

    def __init__(self, probe: Probe) -> None:
        self.odom = probe.collect(Odometry, 'odom', wait=False)
        self.clouds = probe.collect(PointCloud2, 'map_points', qos.LATCHED, wait=False)
        self.paths = probe.collect(PathMsg, 'path', qos.LATCHED, wait=False)
        self.markers = probe.collect(MarkerArray, 'keyframes', qos.LATCHED, wait=False)
        super().__init__(probe)
        self.world, self.next = PointWorld(), 0

    def message(self, i: int) -> FeaturesMsg:
        return features_msg(self.world.features(camera_at(i), START_NS + i * PERIOD_NS))

    def send(self, count: int) -> None:
        """Send the next images."""
        for i in range(self.next, self.next + count):
            self.answer_to(self.message(i))
        self.next += count

    def call(self, name: str) -> str:
        answer = self.probe.call(Trigger, f'rgbd_slam/{name}', Trigger.Request())
        assert answer.success
        return str(answer.message)

    def count(self, key: str) -> int:
        """Return a counter of the next diagnostics."""
        return int(self.diagnosis()[1].get(key, '0'))


@pytest.fixture
def peer(start: Start, probe: Probe, tmp_path: Path) -> Peer:
    """Return a peer of a running node that knows its camera."""
    parameters = {'map_directory': str(tmp_path / 'my maps'), 'map_period_s': 0.2}
    start('rgbd_slam', 'rgbd_slam_node', parameters)
    peer = Peer(probe)
    peer.begin()
    assert peer.status[-1].state == SlamStatus.NOT_INITIALIZED
    assert peer.status[-1].frames_processed == 0
    return peer


def test_each_image_yields_odometry_transforms_and_a_status(peer: Peer) -> None:
    peer.send(30)
    peer.probe.spin_until(lambda: len(peer.odom) == 30, 'odometry is missing')
    for i, msg in enumerate(peer.odom):
        assert conversions.stamp_from_msg(msg.header.stamp) == START_NS + i * PERIOD_NS
        assert (msg.header.frame_id, msg.child_frame_id) == ('odom', OPTICAL)
        expected = T_BODY_OPTICAL @ camera_at(i)
        T_odom_camera = conversions.pose_from_msg(msg.pose.pose)
        np.testing.assert_allclose(T_odom_camera, expected, atol=0.004)
    last = peer.odom[-1]
    w, v = last.twist.twist.angular, last.twist.twist.linear  # in the optical frame
    twist = np.array([w.x, w.y, w.z, v.x, v.y, v.z])
    motion = se3.log(se3.inverse(camera_at(28)) @ camera_at(29))
    np.testing.assert_allclose(twist, motion / (PERIOD_NS / 1e9), atol=0.06)
    covariance = np.array(last.pose.covariance).reshape(6, 6)
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    assert np.sqrt(covariance[0, 0]) < 0.02
    of_twist = np.array(last.twist.covariance).reshape(6, 6)
    assert (np.linalg.eigvalsh(of_twist) > 0).all()
    assert np.sqrt(of_twist[0, 0]) < 1.0

    stamp_ns = START_NS + 29 * PERIOD_NS
    assert set(peer.tree(stamp_ns)) == {('map', 'odom'), ('odom', OPTICAL)}
    np.testing.assert_allclose(peer.pose(stamp_ns), T_BODY_OPTICAL @ camera_at(29), atol=0.004)

    status = peer.status[-1]
    assert conversions.stamp_from_msg(status.header.stamp) == stamp_ns
    assert status.header.frame_id == OPTICAL
    assert status.state == SlamStatus.TRACKING
    assert status.frames_processed == 30
    assert status.frames_dropped == 0
    assert status.tracked_points >= status.inliers > 200
    assert status.keyframes >= 1
    assert status.map_points > 200
    assert 'track' in status.stage_names


def test_map_to_odom_can_be_switched_off_at_run_time(peer: Peer) -> None:
    peer.send(2)
    peer.probe.set_parameters('rgbd_slam', {'frames.publish_map_to_odom': False})
    peer.send(1)
    peer.probe.set_parameters('rgbd_slam', {'frames.publish_map_to_odom': True})
    peer.send(1)
    sent = [START_NS + i * PERIOD_NS for i in range(1, 4)]
    peer.probe.spin_until(lambda: bool(edges(peer.tf, sent[-1])), 'no transforms')
    both = {('map', 'odom'), ('odom', OPTICAL)}
    assert [set(edges(peer.tf, ns)) for ns in sent] == [both, {('odom', OPTICAL)}, both]


def test_the_map_period_can_be_changed_at_run_time(peer: Peer) -> None:
    peer.send(1)
    peer.probe.spin_until(lambda: bool(peer.paths), 'no path')
    peer.probe.set_parameters('rgbd_slam', {'map_period_s': 3600.0})
    peer.probe.spin_for(0.3)  # for messages already sent
    before = len(peer.paths)
    while peer.status[-1].keyframes == 1:
        assert peer.next < 150, 'no second keyframe'
        peer.send(10)
    peer.probe.spin_for(0.5)
    assert len(peer.paths) == before
    peer.probe.set_parameters('rgbd_slam', {'map_period_s': 0.1})
    peer.probe.spin_until(lambda: len(peer.paths) > before, 'no path')


def test_the_map_is_latched_for_late_subscribers(peer: Peer) -> None:
    peer.send(10)
    peer.probe.spin_until(lambda: bool(peer.paths and peer.paths[-1].poses), 'no map')
    late = peer.probe.collect(PointCloud2, 'map_points', qos.LATCHED)
    peer.probe.spin_until(lambda: bool(late and late[-1].width), 'no latched message')
    assert late[-1].header.frame_id == 'map'
    points_m = conversions.cloud_from_msg(late[-1]).points_m
    assert len(points_m) > 200
    world_m = se3.transform(T_BODY_OPTICAL, peer.world.points_m)
    gaps_m = np.linalg.norm(points_m[:, None] - world_m[None], axis=2).min(axis=1)
    assert np.median(gaps_m) < 0.005
    path = peer.paths[-1].poses
    assert conversions.stamp_from_msg(path[0].header.stamp) == START_NS
    T_map_first = conversions.pose_from_msg(path[0].pose)
    np.testing.assert_allclose(T_map_first, T_BODY_OPTICAL, atol=1e-9)
    assert len(peer.markers[-1].markers[0].points) == 16 * len(path)


def test_the_status_before_the_first_image_is_latched_for_late_subscribers(peer: Peer) -> None:
    late = peer.probe.collect(SlamStatus, 'slam_status', qos.LATCHED)
    peer.probe.spin_until(lambda: bool(late), 'no latched message')
    assert late == peer.status[-1:]


def test_pause_ignores_images_and_reset_discards_the_map(peer: Peer) -> None:
    peer.send(8)
    assert 'paused' in peer.call('pause')
    peer.send(2)
    assert peer.status[-1].state == SlamStatus.PAUSED
    assert peer.status[-1].frames_processed == 8
    assert 'running' in peer.call('resume')
    peer.send(3)
    assert peer.status[-1].state == SlamStatus.TRACKING
    assert peer.status[-1].frames_processed == 11
    assert peer.status[-1].frames_dropped == 0  # images of the pause do not count as dropped
    peer.call('reset')
    peer.send(1)
    assert peer.status[-1].frames_processed == 1
    assert peer.status[-1].keyframes == 1
    peer.probe.spin_until(lambda: len(peer.odom) == 12, 'odometry is missing')
    T_odom_camera = conversions.pose_from_msg(peer.odom[-1].pose.pose)
    np.testing.assert_allclose(T_odom_camera, T_BODY_OPTICAL, atol=1e-9)


@pytest.mark.parametrize(('kind', 'count'), [('final', 8), ('online', 8), ('keyframes', 1)])
def test_trajectories_are_saved(peer: Peer, tmp_path: Path, kind: str, count: int) -> None:
    peer.send(8)
    request = SaveTrajectory.Request(name=f'{kind}.txt', kind=kind)
    answer = peer.probe.call(SaveTrajectory, 'rgbd_slam/save_trajectory', request)
    assert answer.success, answer.message
    trajectory = read_tum(tmp_path / 'my maps' / f'{kind}.txt')
    assert len(trajectory) >= count
    assert trajectory.stamps_ns[0] == START_NS
    i = len(trajectory) - 1 if kind != 'keyframes' else 0
    expected = T_BODY_OPTICAL @ camera_at(i)
    np.testing.assert_allclose(trajectory.T_world_camera[i], expected, atol=0.004)


def test_trajectories_outside_the_folder_or_of_unknown_kind_are_refused(peer: Peer) -> None:
    peer.send(1)
    for name, kind, message in (
        ('../a.txt', '', 'no plain file name'),
        ('/elsewhere/a.txt', '', 'no plain file name'),
        ('a.txt', 'best', 'no trajectory "best"'),
    ):
        request = SaveTrajectory.Request(name=name, kind=kind)
        answer = peer.probe.call(SaveTrajectory, 'rgbd_slam/save_trajectory', request)
        assert not answer.success
        assert message in answer.message


def test_services_before_the_first_camera_info_are_refused(start: Start, probe: Probe) -> None:
    start('rgbd_slam', 'rgbd_slam_node')
    answer = probe.call(
        SaveTrajectory, 'rgbd_slam/save_trajectory', SaveTrajectory.Request(name='a.txt')
    )
    assert not answer.success
    assert 'nothing has been tracked yet' in answer.message
    answer = probe.call(Trigger, 'rgbd_slam/pause', Trigger.Request())
    assert not answer.success


def test_invalid_features_are_refused_and_counted_while_tracking_continues(peer: Peer) -> None:
    peer.send(2)
    short, outside, nan = (peer.message(5) for _ in range(3))
    short.depth_m = short.depth_m[:-1]
    outside.uv_px[0] = 1e6
    nan.depth_m[3] = float('nan')
    for msg in (short, outside, nan):
        peer.features.publish(msg)
    peer.probe.spin_until(lambda: peer.count('features refused') == 3, 'not counted')
    peer.send(2)
    assert peer.status[-1].state == SlamStatus.TRACKING
    assert peer.status[-1].frames_processed == 4


def test_missing_images_are_counted_as_dropped(peer: Peer) -> None:
    peer.send(10)
    peer.next += 3
    peer.send(1)
    assert peer.status[-1].frames_dropped == 3
    assert peer.status[-1].state == SlamStatus.TRACKING


def test_a_base_frame_is_found_on_tf_static(start: Start, probe: Probe) -> None:
    start(
        'rgbd_slam',
        'rgbd_slam_node',
        {'frames.base': 'base_link', 'frames.map': 'world'},
    )
    peer = Peer(probe)
    peer.send_camera()
    peer.probe.spin_for(0.3)
    peer.features.publish(peer.message(0))
    peer.probe.spin_until(
        lambda: peer.count('features before camera and base were known') == 1, 'not counted'
    )
    assert 'does not join' in peer.diagnostics[-1].status[0].message
    T_base_mast, T_mast_optical = np.eye(4), T_BODY_OPTICAL.copy()
    T_base_mast[:3, 3] = 0.2, 0.0, 1.0
    T_mast_optical[:3, 3] = 0.0, 0.05, 0.0
    static = probe.publisher(TFMessage, '/tf_static', qos.TF_STATIC)
    static.publish(
        TFMessage(
            transforms=[
                conversions.transform_to_msg(T_base_mast, START_NS, 'base_link', 'mast'),
                conversions.transform_to_msg(T_mast_optical, START_NS, 'mast', OPTICAL),
            ]
        )
    )
    probe.spin_for(0.3)
    peer.begin()
    peer.send(10)
    peer.probe.spin_until(lambda: len(peer.odom) == 10, 'odometry is missing')
    assert peer.odom[-1].child_frame_id == 'base_link'
    T_base_camera = T_base_mast @ T_mast_optical
    expected = T_base_camera @ camera_at(9) @ se3.inverse(T_base_camera)
    T_odom_base = conversions.pose_from_msg(peer.odom[-1].pose.pose)
    np.testing.assert_allclose(T_odom_base, expected, atol=0.004)
    stamp_ns = START_NS + 9 * PERIOD_NS
    assert set(peer.tree(stamp_ns)) == {('world', 'odom'), ('odom', 'base_link')}


def test_the_log_tells_when_tracking_begins_is_lost_and_is_found_again(
    peer: Peer, tmp_path: Path
) -> None:
    peer.send(10)
    for i in range(10, 13):  # the lens is covered
        seen = peer.world.features(camera_at(i), START_NS + i * PERIOD_NS)
        peer.answer_to(features_msg(seen.select(np.arange(0))))
    peer.next = 13
    peer.send(10)
    assert peer.status[-1].state == SlamStatus.TRACKING
    log = '\n'.join(path.read_text() for path in tmp_path.glob('log_*/*'))
    lines = [line.partition('[rgbd_slam]: ')[2] for line in log.splitlines() if 'tracking' in line]
    changes = [line.partition(':')[0] for line in lines if not line.startswith('tracking,')]
    assert changes == [
        'tracking has begun',
        'tracking is lost',
        'tracking was recovered after 3 images',
    ]
