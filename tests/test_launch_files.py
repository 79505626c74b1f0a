"""The launch files: the nodes that they start, and how these nodes end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

import psutil
import pytest
from diagnostic_msgs.msg import DiagnosticArray

from hoid_common.camera_topics import CAMERA_TOPICS
from hoid_system_tests import launch_stand_in
from hoid_system_tests.launch_stand_in import DeclareLaunchArgument, Node
from hoid_system_tests.probe import Probe

pytestmark = pytest.mark.thorough

SRC = Path(__file__).parents[1] / 'src'
SUITE = SRC / 'hoid_bringup/launch/hoid.launch.py'
OWN = sorted(p for p in SRC.glob('*/launch/*.launch.py') if p != SUITE)
COMMON = {'namespace', 'params_file', 'use_sim_time', 'respawn', 'autostart', 'log_level'}
LIMIT_S = 90.0
_END_S = 30.0


@pytest.fixture
def _stand_in() -> Iterator[None]:
    """Remove the stand-ins for ROS's launch packages after the test."""
    before = dict(sys.modules)
    yield
    for name in {*sys.modules} - before.keys():
        del sys.modules[name]
    sys.modules.update(before)


def nodes_of(path: Path, *arguments: str) -> dict[str, Node]:
    """Return the nodes that a launch file starts, by package."""
    nodes, _ = launch_stand_in.load(path, list(arguments))
    return {node.package: node for node in nodes}


@pytest.mark.usefixtures('_stand_in')
def test_the_suite_has_four_nodes_and_rviz() -> None:
    assert list(nodes_of(SUITE)) == ['hoid_detector', 'hoid_filter', 'rgbd_slam', 'hoid_scene']
    assert list(nodes_of(SUITE, 'detector:=false', 'scene:=false')) == ['hoid_filter', 'rgbd_slam']


@pytest.mark.usefixtures('_stand_in')
def test_rviz_is_started_where_it_is_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(RuntimeError, match='rviz:=true needs the package rviz2, which is not'):
        nodes_of(SUITE, 'rviz:=true')
    index = tmp_path / 'share/ament_index/resource_index/packages'
    index.mkdir(parents=True)
    (index / 'rviz2').touch()
    path = f'{os.environ["AMENT_PREFIX_PATH"]}{os.pathsep}{tmp_path}'
    monkeypatch.setenv('AMENT_PREFIX_PATH', path)
    assert list(nodes_of(SUITE, 'rviz:=true'))[4:] == ['rviz2']


@pytest.mark.usefixtures('_stand_in')
@pytest.mark.parametrize('path', [SUITE, *OWN], ids=lambda p: p.name)
def test_the_global_frame_tree_is_kept_by_an_argument(path: Path) -> None:
    for arguments, expected in (([], {'/tf', '/tf_static'}), (['tf_in_namespace:=false'], set())):
        for node in nodes_of(path, 'namespace:=a', *arguments).values():
            assert dict(node.remappings).keys() & {'/tf', '/tf_static'} == expected


@pytest.mark.usefixtures('_stand_in')
@pytest.mark.parametrize('camera', CAMERA_TOPICS)
def test_a_camera_preset_remaps_its_topics(camera: str) -> None:
    for node in nodes_of(SUITE, f'camera:={camera}').values():
        renamed = dict(node.remappings)
        assert renamed.items() >= dict(CAMERA_TOPICS[camera].remappings()).items()
        assert (renamed['/tf'], renamed['/tf_static']) == ('tf', 'tf_static')


@pytest.mark.usefixtures('_stand_in')
def test_the_camera_namespace_separates_two_robots() -> None:
    def color(robot: str) -> str:
        nodes = nodes_of(SUITE, 'camera:=realsense', f'camera_namespace:=/{robot}/d435')
        return dict(nodes['hoid_filter'].remappings)['rgb/image']

    assert color('a') == '/a/d435/color/image_raw'
    assert color('b') == '/b/d435/color/image_raw'


@pytest.mark.usefixtures('_stand_in')
def test_topics_are_remapped_by_argument() -> None:
    given = {'rgb_topic': '/c', 'depth_topic': '/d', 'camera_info_topic': '/i', 'map_topic': '/m'}
    nodes = nodes_of(SUITE, 'camera:=zed', *(f'{k}:={v}' for k, v in given.items()))
    renamed = dict(nodes['rgbd_slam'].remappings)
    topics = [renamed[name] for name in ('rgb/image', 'depth/image', 'rgb/camera_info')]
    assert topics == ['/c', '/d', '/i']
    assert (renamed['grid_map'], renamed['grid_map_updates']) == ('/m', '/m_updates')
    assert renamed['rgb/image/compressed'] == '/c/compressed'
    assert renamed['depth/image/compressedDepth'] == '/d/compressedDepth'


@pytest.mark.usefixtures('_stand_in')
@pytest.mark.parametrize(
    ('argument', 'choices'),
    [
        ('camera:=webcam', "['bag', 'realsense', "),
        ('strategy:=foo', "['none', 'person', "),
        ('respawn:=maybe', "['true', 'false', "),
        ('log_level:=loud', "['debug', 'info', "),
    ],
)
def test_choices_are_declared(argument: str, choices: str) -> None:
    name, value = argument.split(':=')
    with pytest.raises(SystemExit) as refused:
        nodes_of(SUITE, argument)
    assert str(refused.value).startswith(f'{name} {value} is not one of {choices}')


@pytest.mark.usefixtures('_stand_in')
@pytest.mark.parametrize('path', OWN, ids=lambda p: p.name)
def test_each_node_has_a_launch_file(path: Path) -> None:
    package = path.parents[1].name
    nodes = nodes_of(path, 'image:=/c', 'log_level:=debug', 'respawn:=True')
    assert list(nodes) == [package]
    renamed = dict(nodes[package].remappings)
    assert renamed['rgb/image'] == '/c'
    assert renamed['rgb/image/compressed'] == '/c/compressed'
    assert nodes[package].arguments[-1] == 'debug'
    assert nodes[package].respawn


@pytest.mark.usefixtures('_stand_in')
@pytest.mark.parametrize('path', [SUITE, *OWN], ids=lambda p: p.name)
def test_all_arguments_are_described(path: Path) -> None:
    described = {
        argument.name: argument.description
        for argument in launch_stand_in.description(path).entities
        if isinstance(argument, DeclareLaunchArgument)
    }
    assert described.keys() > COMMON
    assert all(described.values())


@contextmanager
def launched(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Launch the suite in a new process group, by `ros2 launch` where it is installed."""
    real = find_spec('ros2launch') is not None
    how = ['ros2', 'launch'] if real else [sys.executable, '-m', launch_stand_in.__name__]
    with subprocess.Popen(
        [*how, str(SUITE), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        process_group=0,
    ) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)


def pid_of(launch: subprocess.Popen[str], package: str) -> int | None:
    """Return the process id of a node that a launch started, or None."""
    name = f'{package}_node'
    for child in psutil.Process(launch.pid).children():
        with suppress(psutil.Error):  # it has just ended
            if any(Path(word).name == name for word in child.cmdline()):
                return int(child.pid)
    return None


def await_slam(launch: subprocess.Popen[str], probe: Probe) -> int:
    """Wait for the first diagnostics of the SLAM node, and return its process id."""
    received = probe.collect(DiagnosticArray, '/diagnostics', wait=False)
    probe.spin_until(
        lambda: any(status.name == '/rgbd_slam' for msg in received for status in msg.status),
        'the SLAM node does not start',
        LIMIT_S,
    )
    pid = pid_of(launch, 'rgbd_slam')
    assert pid is not None
    return pid


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize('respawn', ['true', 'false'])
def test_a_node_that_refuses_to_start_ends_the_launch_with_one_line(respawn: str) -> None:
    with launched('model:=/nope.onnx', f'respawn:={respawn}') as launch:
        output, _ = launch.communicate(timeout=LIMIT_S)
    assert sum('/nope.onnx does not exist' in line for line in output.splitlines()) == 1, output
    assert 'hoid_detector refused to start' in output
    assert 'Traceback' not in output


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize('after_s', [0.1, 0.4, 1.0])
def test_an_interrupt_while_nodes_start_ends_the_launch_cleanly(after_s: float) -> None:
    with launched('detector:=false', 'strategy:=none') as launch:
        while pid_of(launch, 'rgbd_slam') is None:
            assert launch.poll() is None
            time.sleep(0.02)
        time.sleep(after_s)  # the nodes import their modules
        os.killpg(launch.pid, signal.SIGINT)
        output, _ = launch.communicate(timeout=_END_S)
    assert launch.returncode == 0, output
    assert 'Caught exception in launch' not in output
    assert 'Traceback' not in output


def test_a_killed_node_is_restarted_and_two_interrupts_end_all_cleanly(probe: Probe) -> None:
    """A terminal sends SIGINT to the whole process group, then launch sends another one."""
    with launched('detector:=false', 'strategy:=none', 'respawn:=true') as launch:
        first = await_slam(launch, probe)
        os.kill(first, signal.SIGKILL)
        assert await_slam(launch, probe) != first
        os.killpg(launch.pid, signal.SIGINT)
        output, _ = launch.communicate(timeout=_END_S)
    assert output.count('process has died') == 1, output  # the one that was killed
    assert 'Traceback' not in output


def test_a_killed_node_ends_a_launch_without_respawn(probe: Probe) -> None:
    with launched('detector:=false', 'strategy:=none') as launch:
        os.kill(await_slam(launch, probe), signal.SIGKILL)
        output, _ = launch.communicate(timeout=_END_S)
    assert 'rgbd_slam ended with status -9' in output
