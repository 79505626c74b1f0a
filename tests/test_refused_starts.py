"""Nodes that refuse to start, and what becomes of the other nodes and of the map."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest
from hoid_msgs.msg import SlamStatus
from std_srvs.srv import Trigger

from hoid_benchmarks.faults.live.commands import full_pipe
from hoid_common.process.entry import EXIT_CONFIG
from hoid_system_tests import launch_stand_in
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import executable
from hoid_system_tests.running_camera import RunningCamera
from hoid_system_tests.started_suite import HOID, LIMIT_S, StartedSuite, started_suite

pytestmark = pytest.mark.thorough

LAUNCH_FILE = Path(__file__).parents[1] / 'src/hoid_bringup/launch/hoid.launch.py'
_HAS_LAUNCH = find_spec('ros2launch') is not None
LAUNCH = ('ros2', 'launch') if _HAS_LAUNCH else (sys.executable, '-m', launch_stand_in.__name__)
Start = Callable[..., tuple[str, ...]]


@pytest.fixture
def params(tmp_path: Path, folder: Path) -> Path:
    """A parameter file, which a test damages while the nodes run."""
    path = tmp_path / 'params.yaml'
    path.write_text(
        'rgbd_slam:\n  ros__parameters:\n    expert: true\n    checkpoint_period_s: 1.0\n'
        f'    map_directory: {folder}\n'
    )
    return path


def by_command(params: Path, *, restart: bool) -> tuple[str, ...]:
    options = ('--no-detector', '--filter', 'none', '--no-scene', '--params', str(params))
    return (*HOID, 'nodes', *options, *(['--restart'] * restart))


def by_launch(params: Path, *, restart: bool) -> tuple[str, ...]:
    arguments = ('detector:=false', 'strategy:=none', 'scene:=false', f'params_file:={params}')
    return (*LAUNCH, str(LAUNCH_FILE), *arguments, f'respawn:={str(restart).lower()}')


def checkpoints(folder: Path) -> list[str]:
    return [file.name for file in folder.glob('.running-*.hoidmap')]


def mapped(suite: StartedSuite, peer: RunningCamera, folder: Path) -> None:
    """Map until there is a checkpoint."""
    peer.await_ready()
    for place in range(20):
        assert peer.send(place).state == SlamStatus.TRACKING
    peer.await_checkpoint(folder)
    assert suite.process.poll() is None


def check_resumed(peer: RunningCamera, place: int = 15) -> None:
    """Check that a new node finds the camera in the map from before."""
    peer.await_ready()
    status = peer.send(place)
    assert 'from before' in peer.status[0].message
    assert (status.state, status.mode) == (SlamStatus.TRACKING, SlamStatus.MAPPING)
    assert status.maps == 1
    peer.check_pose(place)


@pytest.mark.parametrize('command', [by_command, by_launch])
def test_a_refused_restart_is_tried_again_and_the_map_is_kept(
    command: Start, probe: Probe, params: Path, folder: Path, tmp_path: Path
) -> None:
    good = params.read_text()
    with started_suite(command(params, restart=True), tmp_path / 'log') as suite:
        peer = RunningCamera(probe)
        mapped(suite, peer, folder)
        filter_pid = suite.pid_of('hoid_filter')
        params.write_text('rgbd_slam: [')
        suite.kill('rgbd_slam')
        said = suite.await_line(probe, 'rgbd_slam refused to start; the other nodes run on', 2)
        assert 'again' in said
        assert suite.process.poll() is None
        assert suite.pid_of('hoid_filter') == filter_pid
        assert len(checkpoints(folder)) == 1
        params.write_text(good)
        check_resumed(peer)
        assert suite.pid_of('hoid_filter') == filter_pid
    assert 'Traceback' not in (tmp_path / 'log').read_text()


@pytest.mark.parametrize('command', [by_command, by_launch])
def test_a_node_that_fails_ends_the_suite_but_not_the_map(
    command: Start, probe: Probe, params: Path, folder: Path, tmp_path: Path
) -> None:
    with started_suite(command(params, restart=False), tmp_path / 'log') as suite:
        peer = RunningCamera(probe)
        mapped(suite, peer, folder)
        suite.kill('hoid_filter')
        suite.await_end()
    assert len(checkpoints(folder)) == 1
    with started_suite(command(params, restart=False), tmp_path / 'log') as suite:
        check_resumed(peer)
    assert checkpoints(folder) == []  # this time the user has ended it


def test_a_supervisor_that_is_killed_does_not_take_the_map_along(
    probe: Probe, params: Path, folder: Path, tmp_path: Path
) -> None:
    with started_suite(by_command(params, restart=True), tmp_path / 'log') as suite:
        mapped(suite, RunningCamera(probe), folder)
        slam = suite.pid_of('rgbd_slam')
        suite.process.kill()
        assert suite.await_end() == -signal.SIGKILL
        probe.spin_until(lambda: not Path(f'/proc/{slam}').exists(), 'SLAM does not end', LIMIT_S)
    assert len(checkpoints(folder)) == 1


def test_a_model_that_is_cut_while_it_runs_does_not_end_the_suite(
    probe: Probe, params: Path, folder: Path, tmp_path: Path
) -> None:
    model = tmp_path / 'model.onnx'
    good = (Path(__file__).parents[1] / 'lab/models/synthetic.onnx').read_bytes()
    model.write_bytes(good)
    argv = (*HOID, 'nodes', '--params', str(params), '--detector', str(model), '--restart')
    with started_suite(argv, tmp_path / 'log') as suite:
        peer = RunningCamera(probe)
        mapped(suite, peer, folder)
        slam = suite.pid_of('rgbd_slam')
        model.write_bytes(good[: len(good) // 2])
        suite.kill('hoid_detector')
        suite.await_line(probe, 'hoid_detector refused to start; the other nodes run on', 2)
        assert suite.await_line(probe, f'error: {model} is no usable ONNX model: ')
        model.write_bytes(good)
        suite.await_line(probe, '[hoid_detector]: model.onnx: yolov8', 2)
        assert suite.pid_of('rgbd_slam') == slam
        assert peer.send(20).state == SlamStatus.TRACKING


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize('restart', [True, False])
def test_too_few_descriptors_end_the_suite_in_one_line(restart: bool, params: Path) -> None:
    argv = ('bash', '-c', 'ulimit -n 40; exec "$@"', 'bash', *by_command(params, restart=restart))
    done = subprocess.run(argv, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith('hoid nodes: this process may have 40 files open at once and needs 256')


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize(
    ('prefix', 'option', 'message'),
    [
        (
            ('bash', '-c', 'ulimit -n 40; exec "$@"', 'bash'),
            'x:=1',
            'error: this process may have 40',
        ),
        (
            (),
            'map_directory:=~nosuchuser/x',
            'error: map_directory: ~nosuchuser/x: no home folder',
        ),
    ],
    ids=['descriptors', 'home'],
)
def test_a_node_names_what_it_lacks_in_one_line(
    prefix: tuple[str, ...], option: str, message: str
) -> None:
    program = str(executable('rgbd_slam', 'rgbd_slam_node'))
    argv = (*prefix, program, '--ros-args', '-p', option)
    done = subprocess.run(argv, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == EXIT_CONFIG
    (line,) = done.stderr.splitlines()
    assert line.startswith(message)


@pytest.mark.parametrize('is_supervised', [True, False], ids=['hoid nodes', 'ros2 run'])
def test_nodes_work_on_when_nobody_reads_their_output(
    is_supervised: bool, probe: Probe, params: Path
) -> None:
    program = str(executable('rgbd_slam', 'rgbd_slam_node'))
    argv = [program, '--ros-args', '--params-file', str(params)]
    if is_supervised:
        argv = [*HOID, 'nodes', '--only', 'rgbd_slam', '--params', str(params)]
    with full_pipe() as pipe:
        process = subprocess.Popen(argv, stdout=pipe, stderr=pipe, process_group=0)
        try:
            peer = RunningCamera(probe)
            peer.await_ready()
            for place in range(20):
                assert peer.send(place).state == SlamStatus.TRACKING
                peer.check_pose(place)
            for name in ('resume', 'reset'):
                assert probe.call(Trigger, f'rgbd_slam/{name}', Trigger.Request()).success
            assert not peer.load('not there').success  # which logs a line
            assert peer.send(20).keyframes == 1
            process.send_signal(signal.SIGINT)
            assert process.wait(LIMIT_S) == 0
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
