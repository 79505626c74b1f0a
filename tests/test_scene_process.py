"""The scene process is replaced when it dies; all its outputs belong to the SLAM node."""

from __future__ import annotations

import copy
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from hoid_msgs.msg import SlamStatus
from tf2_msgs.msg import TFMessage

from hoid_common.ros import conversions, qos
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_synth.config import SceneConfig
from hoid_synth.room_truth import RoomTruth
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.rendered_room import Messages, recording
from hoid_system_tests.scene_peer import RELIABLE, ScenePeer
from rgbd_slam.robot_frames import camera_mount

pytestmark = [pytest.mark.thorough, pytest.mark.alone]

SCENE = SceneConfig(num_frames=70, width_px=320)
SCENE_NODE = '/rgbd_slam_scene'
_RESTORED_S = 10.0  # limit for a new process to restore the dense map
_FLOOR_S = 30.0  # limit for the report of a missing floor


@pytest.fixture(scope='module')
def messages() -> list[Messages]:
    return list(recording(SCENE, 'hoid+'))


@pytest.fixture
def peer(start: Start, probe: Probe, tmp_path: Path, messages: list[Messages]) -> ScenePeer:
    parameters = {'map_directory': str(tmp_path / 'maps'), 'dense.publish_period_s': 0.3}
    start('rgbd_slam', 'rgbd_slam_node', parameters | {'dense.rate_hz': 10.0} | RELIABLE)
    peer = ScenePeer(probe)
    peer.begin(messages[0].camera)
    return peer


def play(peer: ScenePeer, images: list[Messages]) -> None:
    assert {status.state for status in peer.play(images)} == {SlamStatus.TRACKING}


def test_the_threads_of_the_middleware_keep_their_priority(peer: ScenePeer) -> None:
    """Other participants would consider the process dead if these threads ran at idle priority."""
    pid = int(peer.diagnosis(SCENE_NODE)[1]['process'])
    policies = {
        (task / 'comm').read_text().strip(): os.sched_getscheduler(int(task.name))
        for task in Path(f'/proc/{pid}/task').iterdir()
    }
    receiving = {policy for name, policy in policies.items() if name.startswith('dds.')}
    assert receiving == {os.sched_getscheduler(0)}
    assert os.sched_getscheduler(pid) == os.SCHED_IDLE


def test_a_color_image_of_another_size_is_refused_and_counted(
    peer: ScenePeer, messages: list[Messages]
) -> None:
    play(peer, messages[:10])
    pid = peer.diagnosis(SCENE_NODE)[1]['process']
    for image in messages[10:16]:  # some of these are fused
        narrow = copy.deepcopy(image.color)
        narrow.width = 1
        play(peer, [image._replace(color=narrow)])
    peer.probe.spin_for(1.0)
    assert int(peer.diagnosis(SCENE_NODE)[1]['images refused']) > 0
    play(peer, messages[16:20])
    assert peer.diagnosis(SCENE_NODE)[1]['process'] == pid


def test_a_scene_process_that_dies_is_replaced_and_its_map_restored(
    peer: ScenePeer, messages: list[Messages]
) -> None:
    play(peer, messages[:40])
    peer.probe.spin_for(2.0)  # until everything is mapped, published, and copied to the SLAM node
    before_m = peer.cloud_m()
    voxels = int(peer.diagnosis(SCENE_NODE)[1]['voxels'])
    pid = int(peer.diagnosis(SCENE_NODE)[1]['process'])
    os.kill(pid, signal.SIGKILL)
    killed_s = time.monotonic()
    peer.clouds.clear()
    play(peer, messages[40:42])  # images are not mapped while there is no process
    after_m = peer.cloud_m()
    assert time.monotonic() - killed_s < _RESTORED_S
    assert abs(len(after_m) - len(before_m)) < 0.1 * len(before_m)
    truth = RoomTruth(SCENE, T_BODY_OPTICAL)
    assert np.mean(truth.distance_m(after_m) < 0.03) >= 0.98
    message, values = peer.diagnosis('/rgbd_slam')
    assert 'has ended' not in message
    assert values['scene processes that died'] == '1'
    assert int(peer.diagnosis(SCENE_NODE)[1]['process']) != pid
    play(peer, messages[42:])  # mapping continues
    peer.probe.spin_for(1.0)
    assert int(peer.diagnosis(SCENE_NODE)[1]['voxels']) > 0.9 * voxels
    assert peer.save('grid', 'grid').success


def test_the_dense_map_is_restored_after_the_node_was_killed(
    start: Start, probe: Probe, tmp_path: Path, messages: list[Messages]
) -> None:
    folder = tmp_path / 'maps'
    parameters = {'map_directory': str(folder), 'dense.publish_period_s': 0.3}
    parameters |= {'dense.rate_hz': 10.0, 'checkpoint_period_s': 1.0} | RELIABLE
    node = start('rgbd_slam', 'rgbd_slam_node', parameters)
    peer = ScenePeer(probe)
    peer.begin(messages[0].camera)
    play(peer, messages[:40])
    peer.probe.spin_for(4.0)  # until everything is mapped, published, and written
    before_m = peer.cloud_m()
    for pid in node.pids.values():
        os.kill(pid, signal.SIGKILL)
    peer.clouds.clear()
    peer.status.clear()
    start('rgbd_slam', 'rgbd_slam_node', parameters)
    began_s = time.monotonic()
    peer.begin(messages[40].camera)
    play(peer, messages[40:42])
    after_m = peer.cloud_m()
    assert time.monotonic() - began_s < _RESTORED_S
    assert len(after_m) > 0.9 * len(before_m)  # two images show only a third of it
    assert np.mean(RoomTruth(SCENE, T_BODY_OPTICAL).distance_m(after_m) < 0.03) >= 0.98


def test_all_services_and_outputs_belong_to_the_slam_node(peer: ScenePeer) -> None:
    node = peer.probe.node
    services = dict(node.get_service_names_and_types_by_node('rgbd_slam', '/'))
    own = {name.removeprefix('/rgbd_slam/') for name in services}
    assert own >= {
        'reset', 'pause', 'resume', 'set_mode', 'save_map', 'load_map', 'save_trajectory',
        'save_cloud', 'save_grid', 'find_objects', 'forget_object', 'save_objects',
    }  # fmt: skip
    published = dict(node.get_publisher_names_and_types_by_node('rgbd_slam', '/'))
    assert published.keys() >= {
        '/odom', '/tf', '/path', '/map_points', '/keyframes', '/slam_status', '/cloud_map',
        '/grid_map', '/tracked_objects', '/tracked_objects/markers',
    }  # fmt: skip
    helpers = set(node.get_node_names()) - {'rgbd_slam', node.get_name()}
    assert helpers == {'rgbd_slam_scene'}
    served = dict(node.get_service_names_and_types_by_node('rgbd_slam_scene', '/'))
    assert all('parameter' in name or 'type_desc' in name for name in served)
    assert set(dict(node.get_publisher_names_and_types_by_node('rgbd_slam_scene', '/'))) <= {
        '/diagnostics', '/rosout', '/parameter_events',
    }  # fmt: skip


def test_a_tilted_mount_that_shows_no_level_floor_is_reported(
    start: Start, probe: Probe, tmp_path: Path, messages: list[Messages]
) -> None:
    parameters = {
        'map_directory': str(tmp_path / 'maps'), 'frames.base': 'base_link',
        'dense.publish_period_s': 0.1, 'dense.rate_hz': 30.0,
    }  # fmt: skip
    start('rgbd_slam', 'rgbd_slam_node', parameters | RELIABLE)
    tree = probe.publisher(TFMessage, '/tf_static', qos.TF_STATIC)
    mount = camera_mount(0.0, 45.0, 0.0)  # which is not how the camera is mounted
    frame = messages[0].camera.header.frame_id
    tree.publish(
        TFMessage(transforms=[conversions.transform_to_msg(mount, 0, 'base_link', frame)])
    )
    peer = ScenePeer(probe)
    peer.begin(messages[0].camera)
    play(peer, messages[:60])
    probe.spin_until(
        lambda: peer.diagnosis(SCENE_NODE)[0].startswith('no level floor has been seen'),
        'the missing floor is not reported', _FLOOR_S,
    )  # fmt: skip
    assert '--mount ROLL PITCH YAW' in peer.diagnosis(SCENE_NODE)[0]
    assert 'base_frame' in peer.save(what='grid').message
