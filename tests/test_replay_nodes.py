"""`hoid nodes`: the nodes start and end together."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from hoid_system_tests.probe import Probe

Run = Callable[..., subprocess.Popen[str]]
READY_S = 60.0


@pytest.fixture
def run_nodes(domain_id: int, tmp_path: Path) -> Iterator[Run]:
    """Start `hoid nodes` without a detector."""
    running: list[subprocess.Popen[str]] = []

    def run(*options: str) -> subprocess.Popen[str]:
        argv = [sys.executable, '-m', 'hoid_bringup', 'nodes', '--no-detector', *options]
        argv += ['--filter', 'none', '--log-dir', str(tmp_path / 'logs')]
        env = {**os.environ, 'ROS_DOMAIN_ID': str(domain_id)}
        running.append(subprocess.Popen(argv, env=env, stderr=subprocess.PIPE, text=True))
        return running[-1]

    yield run
    for process in running:
        process.kill()
        process.wait()


def children(process: subprocess.Popen[str]) -> dict[str, psutil.Process]:
    """Return the node processes by package."""
    found = {}
    for child in psutil.Process(process.pid).children():
        with suppress(psutil.NoSuchProcess):
            command = ' '.join(child.cmdline())
            for package in ('hoid_filter', 'rgbd_slam'):
                if f"start('{package}.node')" in command:
                    found[package] = child
    return found


def wait_for_graph(probe: Probe, namespace: str = '') -> None:
    wanted = {(name, f'/{namespace}') for name in ('hoid_filter', 'rgbd_slam')}
    probe.spin_until(
        lambda: wanted <= set(probe.node.get_node_names_and_namespaces()), 'no nodes', READY_S
    )


def test_ctrl_c_ends_all_nodes_of_a_namespace(run_nodes: Run, probe: Probe) -> None:
    process = run_nodes('--namespace', 'robot_1')
    wait_for_graph(probe, 'robot_1')
    nodes = children(process)
    assert set(nodes) == {'hoid_filter', 'rgbd_slam'}
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 0
    assert not any(psutil.pid_exists(node.pid) for node in nodes.values())


def test_a_killed_node_is_reported_and_ends_the_others(run_nodes: Run, probe: Probe) -> None:
    process = run_nodes()
    wait_for_graph(probe)
    nodes = children(process)
    nodes['rgbd_slam'].kill()
    assert process.wait(30) == 1
    assert process.stderr is not None
    assert 'hoid nodes: rgbd_slam ended (signal SIGKILL)' in process.stderr.read()
    assert not psutil.pid_exists(nodes['hoid_filter'].pid)


def test_a_killed_node_is_restarted_with_the_option(run_nodes: Run, probe: Probe) -> None:
    process = run_nodes('--restart')
    wait_for_graph(probe)
    before = children(process)['rgbd_slam']
    before.kill()

    def restarted() -> psutil.Process | None:
        node = children(process).get('rgbd_slam')
        return None if node == before else node

    probe.spin_until(lambda: restarted() is not None, 'the node is not restarted', READY_S)
    after = restarted()
    assert process.poll() is None
    process.kill()  # its nodes end even then
    assert after is not None
    assert psutil.wait_procs([after], timeout=30)[0] == [after]


def test_a_missing_parameter_file_is_reported(run_nodes: Run) -> None:
    process = run_nodes('--params', 'nowhere.yaml')
    assert process.wait(30) == 1
    assert process.stderr is not None
    assert process.stderr.read() == 'hoid nodes: nowhere.yaml: no such file\n'
