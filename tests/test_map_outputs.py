"""Path, map points and keyframes are made for subscribers only, and without delaying tracking."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Path
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from hoid_common import se3
from hoid_common.ros import conversions, qos
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import Features, FloatArray
from hoid_system_tests.point_world import CAMERA, PointWorld, pose_after
from hoid_system_tests.probe import Probe
from hoid_system_tests.slam_peer import PERIOD_NS, START_NS
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.ros import map_outputs
from rgbd_slam.ros.map_outputs import MapOutputs
from rgbd_slam.session import SlamSession

TOPICS: dict[str, type[Any]] = {
    'path': Path,
    'map_points': PointCloud2,
    'keyframes': MarkerArray,
}
LONG = SlamNodeConfig().updated({'map_period_s': 3600.0})
SHORT = SlamNodeConfig().updated({'map_period_s': 0.1})
TURN_RAD = 0.05  # per image, so that every few images become a keyframe


class Bench:
    """A session in this process, and the topics of its map."""

    def __init__(self, probe: Probe, config: SlamNodeConfig) -> None:
        self.probe, self.world = probe, PointWorld()
        self.session = SlamSession(CAMERA, config, RobotFrames())
        self.outputs = MapOutputs(probe.node, config, lambda: self.session)

    def see(self, n: int, stamp_ns: int) -> None:
        """Process the image of place `n`."""
        features: Features = self.world.features(pose_after(n, turn_rad=TURN_RAD), stamp_ns)
        self.session.process(features)

    def join(self, topic: str) -> list[Any]:
        return self.probe.collect(TOPICS[topic], topic, qos.LATCHED, wait=False)

    def await_count(self, received: list[Any], count: int) -> None:
        self.probe.spin_until_count(received, count, f'fewer than {count} messages')


def stamps_of(path: Path) -> list[int]:
    return [conversions.stamp_from_msg(pose.header.stamp) for pose in path.poses]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the names of the messages that are made, as they are made."""
    names: list[str] = []

    def spied(name: str, make: Callable[..., Any]) -> Callable[..., Any]:
        def spy(*args: Any) -> Any:
            names.append(name)
            return make(*args)

        return spy

    for name in ('path_to_cdr', 'cloud_to_cdr', 'keyframes_to_cdr'):
        monkeypatch.setattr(map_outputs, name, spied(name, getattr(map_outputs, name)))
    return names


def test_messages_are_made_for_subscribers_only_and_at_once_for_late_ones(
    probe: Probe, made: list[str]
) -> None:
    bench = Bench(probe, LONG)
    bench.see(0, START_NS)
    probe.spin_for(0.3)
    assert made == []
    paths = bench.join('path')
    bench.await_count(paths, 1)  # long before the period has passed
    assert made == ['path_to_cdr']
    assert stamps_of(paths[0]) == [START_NS]
    late = bench.join('path')
    bench.await_count(late, 1)
    probe.spin_for(0.2)
    assert made == ['path_to_cdr']  # the map is the same: the middleware has the message
    clouds, markers = bench.join('map_points'), bench.join('keyframes')
    bench.await_count(clouds, 1)
    bench.await_count(markers, 1)
    world_m = se3.transform(T_BODY_OPTICAL, bench.world.points_m)
    points_m = conversions.cloud_from_msg(clouds[0]).points_m
    assert len(points_m) == bench.session.slam.stats.num_map_points > 200
    gaps_m = np.linalg.norm(points_m[:, None] - world_m[None], axis=2).min(axis=1)
    assert np.median(gaps_m) < 0.005
    assert len(markers[0].markers[0].points) == 16


def test_the_path_has_the_stamps_of_the_current_pass_of_a_bag_in_a_loop(probe: Probe) -> None:
    bench = Bench(probe, SHORT)
    paths = bench.join('path')
    stamps_ns = START_NS + 5 * PERIOD_NS * np.arange(20)
    for n, stamp_ns in enumerate(stamps_ns.tolist()):
        bench.see(n, stamp_ns)
    bench.await_count(paths, 1)
    assert len(stamps_of(paths[-1])) > 2
    again_ns = (stamps_ns[:18] + 1).tolist()  # the simulation starts again
    for n, stamp_ns in enumerate(again_ns):
        bench.see(-n, stamp_ns)
        bench.see(-n, stamp_ns)  # and repeats each image
    probe.spin_until(lambda: stamps_of(paths[-1])[-1] in again_ns, 'no path of the second pass')
    latest = stamps_of(paths[-1])
    assert len(latest) > 1
    assert latest == sorted(set(latest))
    assert set(latest) <= set(again_ns)


def test_a_large_map_is_copied_in_parts_and_arrives_whole(
    probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(map_outputs, '_ROWS', 100)
    bench = Bench(probe, LONG)
    bench.see(0, START_NS)
    clouds = bench.join('map_points')
    bench.await_count(clouds, 1)
    found_m = conversions.cloud_from_msg(clouds[0]).points_m
    expected_m: FloatArray = bench.session.map.points_m()
    assert len(found_m) > 200
    np.testing.assert_allclose(found_m, expected_m, atol=1e-5)
