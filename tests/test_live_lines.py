"""What a user reads while nodes run: lines of the start and the end, and `hoid status`."""

from __future__ import annotations

import re
import signal
import subprocess
from pathlib import Path

import pytest

from hoid_common.errors import counted
from hoid_system_tests.probe import Probe
from hoid_system_tests.running_camera import RunningCamera
from hoid_system_tests.started_suite import HOID, LIMIT_S, StartedSuite, started_suite

pytestmark = [pytest.mark.thorough, pytest.mark.alone]


def status(*options: str) -> subprocess.CompletedProcess[str]:
    argv = (*HOID, 'status', *options)
    return subprocess.run(argv, capture_output=True, text=True, timeout=LIMIT_S, check=False)


@pytest.mark.parametrize('has_logs', [False, True], ids=['terminal', 'log files'])
def test_nodes_say_what_they_wait_for_and_what_became_of_the_map(
    has_logs: bool, probe: Probe, folder: Path, tmp_path: Path
) -> None:
    options = ('--log-dir', str(tmp_path / 'logs')) if has_logs else ()
    argv = (*HOID, 'nodes', '--no-detector', '--filter', 'none', '--no-scene', *options)
    with started_suite((*argv, '--set', f'map_directory={folder}'), tmp_path / 'out') as suite:
        suite.await_line(probe, 'hoid nodes: hoid_filter, rgbd_slam started; Ctrl-C ends them')
        for node, inputs in (
            ('hoid_filter', 'color images on /rgb/image, depth images on /depth/image'),
            ('rgbd_slam', 'camera infos on /rgb/camera_info, features on /features'),
        ):
            line = suite.await_line(probe, f'[{node}]: active, waiting for ')
            assert inputs in line
        check_without_driver(suite, probe)
        keyframes = drive(probe)
        suite.process.send_signal(signal.SIGINT)
        assert suite.await_end() == 0
        assert suite.await_line(probe, 'hoid nodes: ending the nodes')
        line = suite.await_line(
            probe, f'map of {counted(keyframes, "keyframe")} kept as {folder}/kept-'
        )
        assert '; load it with ' in line


def check_without_driver(suite: StartedSuite, probe: Probe) -> None:
    suite.await_line(probe, 'no publisher')
    done = status()
    assert done.returncode == 0
    assert re.search(
        r'hoid_filter: .*no color images yet for [\d.]+ s on /rgb/image: no publisher', done.stdout
    )
    assert 'to do   start the camera driver or play a bag' in done.stdout
    assert 'state   no image was processed yet' in done.stdout


def drive(probe: Probe) -> int:
    """Map 30 places, check what `status` says after that, and return the number of keyframes."""
    camera = RunningCamera(probe)
    camera.await_ready()
    camera.send_all(range(30))
    text = status().stdout
    assert 'state   no image arrives; before that: tracking, mapping' in text
    assert re.search(r'rgbd_slam: no features for [\d.]+ s on /features', text)
    assert 'images  30 processed, 0 missing (by gaps between the stamps' in text
    return int(camera.status[-1].keyframes)


@pytest.mark.usefixtures('domain_id')
def test_status_without_nodes_says_what_to_start(domain_id: int) -> None:
    done = status('--wait', '1')
    assert done.returncode == 1
    assert done.stderr == (
        f'hoid status: no node of the suite reports in namespace / of ROS domain {domain_id} in '
        '1 s: start "./hoid nodes"\n'
    )


def test_status_names_the_namespace_of_running_nodes(
    probe: Probe, folder: Path, tmp_path: Path
) -> None:
    argv = (*HOID, 'nodes', '--only', 'rgbd_slam', '--namespace', 'robot')
    with started_suite((*argv, '--set', f'map_directory={folder}'), tmp_path / 'out') as suite:
        suite.await_line(probe, 'active, waiting for')
        assert 'but there are some in /robot: give that as --namespace' in status().stderr
        assert 'rgbd_slam: no camera infos yet' in status('--namespace', 'robot').stdout
