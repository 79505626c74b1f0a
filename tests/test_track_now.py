"""Filter and SLAM with a slow detector: poses do not wait, late verdicts retract map points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from nav_msgs.msg import Odometry
from sensor_msgs.msg import PointCloud2

from hoid_common.ros import conversions, qos
from hoid_common.values import FloatArray
from hoid_system_tests.filter_peer import CAMERA, DEPTH_M, PERSON, FilterRunner, num_inside
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.slam_peer import SlamPeer

WALL_M, PERSON_M = 3.0, 1.5


def test_map_points_on_a_person_detected_late_are_retracted(
    run_filter: FilterRunner, start: Start, probe: Probe, tmp_path: Path
) -> None:
    parameters = {'map_directory': str(tmp_path), 'map_period_s': 0.2}
    start('rgbd_slam', 'rgbd_slam_node', parameters)
    odometry = probe.collect(Odometry, 'odom', wait=False)
    clouds = probe.collect(PointCloud2, 'map_points', qos.LATCHED, wait=False)
    slam = SlamPeer(probe)  # before the filter's peer, which publishes the camera to both nodes
    peer = run_filter(**{'detections.wait_s': 10.0})
    slam.begin(conversions.camera_to_msg(CAMERA, peer.header(0)))
    peer.send_boxes(-1)  # images wait for the first detections of all
    probe.spin_for(0.3)
    depth_m = np.full_like(DEPTH_M, WALL_M)
    depth_m[50:450, 100:300] = PERSON_M

    def send_images(i: int) -> None:
        peer.send_images(i, depth_m)
        probe.spin_until(lambda: len(odometry) == i + 1, 'no pose at once')

    def ahead_m() -> FloatArray:  # x of the map points, along which the first image looks
        return conversions.cloud_from_msg(clouds[-1]).points_m[:, 0].astype(np.float64)

    for i in range(3):
        send_images(i)
    probe.spin_until(lambda: bool(clouds and clouds[-1].width), 'no map')
    assert np.count_nonzero(ahead_m() < 2.0) > 50
    num_behind = np.count_nonzero(ahead_m() > 2.0)
    for i in range(3):
        peer.send_boxes(i, PERSON)
    # The mapper receives the verdicts; the tracker receives the map with a later image.
    peer.probe.spin_for(0.5)
    for i in range(3, 6):
        send_images(i)
        assert num_inside(peer.features[-1], PERSON) == 0
    probe.spin_until(lambda: not (ahead_m() < 2.0).any(), 'points on the person are not retracted')
    assert np.count_nonzero(ahead_m() > 2.0) > 0.9 * num_behind
    position = odometry[-1].pose.pose.position
    assert np.linalg.norm([position.x, position.y, position.z]) < 0.01
