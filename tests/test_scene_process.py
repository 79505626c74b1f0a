"""The scene node restores its maps when it or the SLAM node dies, and needs no other node."""

from __future__ import annotations

import copy
import os
import signal
from collections.abc import Collection
from pathlib import Path

import numpy as np
import pytest
from hoid_msgs.msg import SlamStatus
from tf2_msgs.msg import TFMessage

from hoid_bringup.live.supervisor import Supervisor
from hoid_common.ros import conversions, qos
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import FloatArray
from hoid_synth.config import SceneConfig
from hoid_synth.room_truth import RoomTruth
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.rendered_room import Messages, recording
from hoid_system_tests.scene_peer import RELIABLE, SceneNodes, ScenePeer, start_scene
from rgbd_slam.robot_frames import camera_mount

pytestmark = [pytest.mark.thorough, pytest.mark.alone]

SCENE = SceneConfig(num_frames=70, width_px=320)
SCENE_NODE = '/hoid_scene'
SCENE_PARAMETERS = {'dense.publish_period_s': 0.3, 'dense.rate_hz': 10.0}
_RESTORED_S = 10.0  # limit for a new process to restore the dense map
_FLOOR_S = 30.0  # limit for the report of a missing floor


@pytest.fixture(scope='module')
def messages() -> list[Messages]:
    return list(recording(SCENE, 'hoid+'))


@pytest.fixture
def peer(start: Start, probe: Probe, tmp_path: Path, messages: list[Messages]) -> ScenePeer:
    start_scene(start, SCENE_PARAMETERS, map_directory=str(tmp_path / 'maps'))
    peer = ScenePeer(probe)
    peer.begin(messages[0].camera)
    return peer


def play(peer: ScenePeer, images: list[Messages]) -> None:
    assert {status.state for status in peer.play(images)} == {SlamStatus.TRACKING}


@pytest.fixture
def nodes(start: Start, tmp_path: Path) -> SceneNodes:
    both = {'map_directory': str(tmp_path / 'maps')}
    return start_scene(start, SCENE_PARAMETERS, {'checkpoint_period_s': 1.0}, **both)


def the_pid(node: Supervisor) -> int:
    (pid,) = node.pids.values()
    return pid


def test_the_threads_of_the_middleware_keep_their_priority(
    nodes: SceneNodes, probe: Probe, messages: list[Messages]
) -> None:
    """Other participants would consider the process dead if these threads ran at idle priority."""
    ScenePeer(probe).begin(messages[0].camera)
    probe.spin_until(lambda: 'hoid_scene' in probe.node.get_node_names(), 'no scene node')
    probe.spin_for(1.0)
    pid = the_pid(nodes.scene)
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
    for image in messages[10:16]:  # some of these are fused
        narrow = copy.deepcopy(image.color)
        narrow.width = 1
        play(peer, [image._replace(color=narrow)])
    peer.probe.spin_for(1.0)
    assert int(peer.diagnosis(SCENE_NODE)[1]['images refused']) > 0
    fused = int(peer.diagnosis(SCENE_NODE)[1]['images fused'])
    play(peer, messages[16:20])
    peer.probe.spin_for(1.0)
    assert int(peer.diagnosis(SCENE_NODE)[1]['images fused']) > fused


def mapped_before_a_death(
    nodes: SceneNodes, probe: Probe, messages: list[Messages], killed: Collection[str]
) -> tuple[ScenePeer, FloatArray]:
    """Play 40 images, kill nodes, and return the points (N, 3) of the dense map before."""
    peer = ScenePeer(probe)
    peer.begin(messages[0].camera)
    play(peer, messages[:40])
    peer.probe.spin_for(4.0)  # until everything is mapped, published, and written
    before_m = peer.cloud_m()
    for name in killed:
        supervisor: Supervisor = getattr(nodes, name)
        for pid in supervisor.pids.values():
            os.kill(pid, signal.SIGKILL)
        supervisor.stop()
    peer.clouds.clear()
    return peer, before_m


def check_restored(before_m: FloatArray, after_m: FloatArray) -> None:
    assert abs(len(after_m) - len(before_m)) < 0.1 * len(before_m)
    assert np.mean(RoomTruth(SCENE, T_BODY_OPTICAL).distance_m(after_m) < 0.03) >= 0.98


def test_a_scene_node_that_was_killed_restores_its_map(
    nodes: SceneNodes, start: Start, probe: Probe, tmp_path: Path, messages: list[Messages]
) -> None:
    peer, before_m = mapped_before_a_death(nodes, probe, messages, ['scene'])
    play(peer, messages[40:42])  # images are not mapped while there is no scene node
    both = {'map_directory': str(tmp_path / 'maps')}
    start('hoid_scene', 'hoid_scene_node', RELIABLE | SCENE_PARAMETERS | both)
    check_restored(before_m, peer.cloud_m())
    voxels = 0.9 * len(before_m)
    play(peer, messages[42:])  # mapping continues
    peer.probe.spin_for(1.0)
    assert int(peer.diagnosis(SCENE_NODE)[1]['voxels']) > voxels
    assert peer.save('grid', 'grid').success


@pytest.mark.parametrize('killed', [['slam'], ['slam', 'scene']], ids=['slam', 'both'])
def test_the_dense_map_continues_after_the_slam_node_was_killed(
    nodes: SceneNodes,
    start: Start,
    probe: Probe,
    tmp_path: Path,
    messages: list[Messages],
    killed: list[str],
) -> None:
    peer, before_m = mapped_before_a_death(nodes, probe, messages, killed)
    peer.status.clear()
    both = {'map_directory': str(tmp_path / 'maps')} | RELIABLE
    start('rgbd_slam', 'rgbd_slam_node', both | {'checkpoint_period_s': 1.0})
    if 'scene' in killed:
        start('hoid_scene', 'hoid_scene_node', both | SCENE_PARAMETERS)
    peer.begin(messages[40].camera)
    play(peer, messages[40:42])
    probe.spin_until(
        lambda: bool(peer.clouds) and peer.clouds[-1].width > 0.9 * len(before_m),
        'the dense map is not restored',
        _RESTORED_S,
    )  # two images show only a third of it
    after_m = peer.cloud_m()
    assert np.mean(RoomTruth(SCENE, T_BODY_OPTICAL).distance_m(after_m) < 0.03) >= 0.98


def test_each_node_has_its_own_services_and_outputs(peer: ScenePeer) -> None:
    node = peer.probe.node

    def services(name: str) -> set[str]:
        found = dict(node.get_service_names_and_types_by_node(name, '/'))
        return {service.removeprefix(f'/{name}/') for service in found}

    of_slam = {
        'reset', 'pause', 'resume', 'set_mode', 'save_map', 'load_map', 'save_trajectory',
    }  # fmt: skip
    of_scene = {
        'save_cloud', 'save_grid', 'find_objects', 'forget_object', 'save_objects', 'add_to_map',
    }  # fmt: skip
    assert services('rgbd_slam') >= of_slam
    assert not services('rgbd_slam') & of_scene
    assert services('hoid_scene') >= of_scene
    published = dict(node.get_publisher_names_and_types_by_node('rgbd_slam', '/'))
    assert published.keys() >= {
        '/odom', '/tf', '/path', '/map_points', '/keyframes', '/slam_status', '/keyframe_poses',
        '/tracked_images',
    }  # fmt: skip
    mapped = dict(node.get_publisher_names_and_types_by_node('hoid_scene', '/'))
    assert mapped.keys() >= {
        '/cloud_map', '/grid_map', '/tracked_objects', '/tracked_objects/markers',
    }  # fmt: skip
    assert set(node.get_node_names()) == {'rgbd_slam', 'hoid_scene', node.get_name()}


def test_a_tilted_mount_that_shows_no_level_floor_is_reported(
    start: Start, probe: Probe, tmp_path: Path, messages: list[Messages]
) -> None:
    start_scene(
        start,
        {'dense.publish_period_s': 0.1, 'dense.rate_hz': 30.0},
        {'frames.base': 'base_link'},
        map_directory=str(tmp_path / 'maps'),
    )
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
        lambda: peer.diagnosis(SCENE_NODE)[0].startswith('no floor has been seen'),
        'the missing floor is not reported', _FLOOR_S,
    )  # fmt: skip
    assert '--mount ROLL PITCH YAW' in peer.diagnosis(SCENE_NODE)[0]
    assert 'base_frame' in peer.save(what='grid').message
