"""Camera drivers as people start them: without the suite's transport profile, of any QoS."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hoid_msgs.msg import SlamStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image

from hoid_common.ros import conversions, qos
from hoid_system_tests.frame_tree import OPTICAL
from hoid_system_tests.plain_camera import PYTHON, cpp_driver, start_plain_camera
from hoid_system_tests.point_world import CAMERA, PointWorld, pose_after
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.sample_bench import SampleBench
from hoid_system_tests.slam_peer import PERIOD_NS, START_NS, SlamPeer, features_msg

COUNT = 90
_PLAY_S = 40.0
TOPIC = '/rgb/image'


@pytest.fixture(params=['c++', pytest.param('python', marks=pytest.mark.thorough)])
def driver(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[str, ...]:
    """Return the command of a driver."""
    return cpp_driver(tmp_path) if request.param == 'c++' else PYTHON


def play(sample: SampleBench, command: tuple[str, ...], reliability: str, depth: int) -> list[str]:
    """Return the diagnostic messages of the node while a driver publishes COUNT images."""
    messages = []
    driver = start_plain_camera(command, reliability, depth, COUNT, TOPIC)

    def has_ended() -> bool:
        messages.append(sample.status().message)
        return driver.poll() is not None

    sample.probe.spin_until(has_ended, 'the driver does not end', _PLAY_S)
    return messages


def requested(sample: SampleBench) -> list[str]:
    found = sample.node.get_subscriptions_info_by_topic(TOPIC)
    return [info.qos_profile.reliability.name for info in found]


@pytest.mark.parametrize('depth', [1, 10])
def test_images_of_a_reliable_driver_without_the_profile_arrive(
    sample: SampleBench, driver: tuple[str, ...], depth: int
) -> None:
    play(sample, driver, 'reliable', depth)
    # All but a few on a busy computer; with best effort, a quarter to a half.
    assert sample.count('color images received') >= 0.8 * COUNT


def test_lost_images_of_a_best_effort_driver_name_the_profile(
    sample: SampleBench, driver: tuple[str, ...]
) -> None:
    messages = play(sample, driver, 'best_effort', 5)
    received, lost = (sample.count(f'color images {what}') for what in ('received', 'lost'))
    assert 0 < received < COUNT - 10
    assert received + lost == pytest.approx(COUNT, abs=2)
    counts = re.search(rf'(\d+) of (\d+) color images on {TOPIC} have arrived in ', messages[-1])
    assert counts is not None, messages[-1]
    assert [int(counts[1]), int(counts[2])] == pytest.approx([received, received + lost], abs=10)
    assert 'start their publisher with FASTRTPS_DEFAULT_PROFILES_FILE=/' in messages[-1]
    assert 'fastdds_profile.xml or reliable QoS' in messages[-1]


def test_reliable_messages_are_requested_again_after_a_best_effort_driver(
    sample: SampleBench,
) -> None:
    spin_until = sample.probe.spin_until
    assert requested(sample) == ['RELIABLE']
    weak = sample.probe.publisher(Image, TOPIC, qos.input_qos('best_effort', 1))
    spin_until(lambda: requested(sample) == ['BEST_EFFORT'], 'reliability is not relaxed')
    sample.probe.node.destroy_publisher(weak)
    spin_until(lambda: requested(sample) == ['RELIABLE'], 'reliability is not restored')
    strong = sample.probe.publisher(Image, TOPIC)
    strong.publish(Image())
    spin_until(lambda: sample.count('color images refused') == 1, 'no message is received')


def test_a_best_effort_driver_that_runs_already_is_asked_for_no_more(domain_id: int) -> None:
    """The driver would print a warning on its console."""
    refused: list[object] = []
    probe = Probe(domain_id)
    probe.node.create_publisher(
        Image,
        TOPIC,
        qos.input_qos('best_effort', 1),
        event_callbacks=PublisherEventCallbacks(incompatible_qos=refused.append),
    )
    bench = SampleBench(domain_id)
    try:
        probe.spin_for(2.0)
        assert requested(bench) == ['BEST_EFFORT']
        assert refused == []
    finally:
        bench.close()
        probe.close()


@pytest.mark.parametrize(
    'profile',
    [qos.LATCHED, QoSProfile(depth=1), qos.input_qos('best_effort', 1)],
    ids=['latched', 'reliable', 'best effort'],
)
def test_a_camera_info_of_any_qos_starts_tracking(
    start: Start, probe: Probe, profile: QoSProfile
) -> None:
    """A latched one is published once, before the node starts."""
    is_latched = profile is qos.LATCHED
    infos = probe.publisher(CameraInfo, 'rgb/camera_info', profile, wait=False)
    info = conversions.camera_to_msg(CAMERA, conversions.header_to_msg(START_NS, OPTICAL))
    if is_latched:
        infos.publish(info)
    start('rgbd_slam', 'rgbd_slam_node')
    peer = SlamPeer(probe)
    if is_latched:
        probe.spin_until(lambda: bool(peer.status), 'the node does not start', 30)
    else:
        probe.spin_for(1.0)
        infos.publish(info)
        probe.spin_until(lambda: bool(peer.status), 'the node does not start', 30)
    world = PointWorld()
    for i in range(3):
        seen = world.features(pose_after(i, turn_rad=0.004), START_NS + i * PERIOD_NS)
        peer.answer_to(features_msg(seen))
    assert peer.status[-1].state == SlamStatus.TRACKING


def test_a_latched_camera_info_from_before_the_activation_is_used(
    start: Start, probe: Probe
) -> None:
    infos = probe.publisher(CameraInfo, 'rgb/camera_info', qos.LATCHED, wait=False)
    header = conversions.header_to_msg(START_NS, OPTICAL)
    infos.publish(conversions.camera_to_msg(CAMERA, header))
    start('rgbd_slam', 'rgbd_slam_node', {'autostart': False})
    peer = SlamPeer(probe)
    probe.spin_for(1.5)
    assert peer.status == []
    for transition in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
        request = ChangeState.Request(transition=Transition(id=transition))
        assert probe.call(ChangeState, 'rgbd_slam/change_state', request).success
    probe.spin_until(lambda: bool(peer.status), 'the node does not start', 30)
