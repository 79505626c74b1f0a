"""The entry point of nodes in a process: how they end, and how they report a failed start."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray

from hoid_common.process.entry import EXIT_CONFIG, EXIT_INTERRUPTED
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start, executable
from hoid_system_tests.slam_peer import SlamPeer

pytestmark = pytest.mark.thorough

NODE = """
import sys, time
from rclpy.node import Node
from hoid_common.errors import ConfigError
from hoid_common.ros.run import run_node

class Tiny(Node):
    def __init__(self):
        super().__init__('tiny')
        if 'fail' in sys.argv:
            raise ConfigError('the focal length is 0; calibrate the camera')
        if 'load' in sys.argv:
            print('loads', flush=True)
            time.sleep(60)
        if 'swallow' in sys.argv:
            print('loads', flush=True)
            try:
                time.sleep(60)
            except BaseException:
                pass
        if 'garble' in sys.argv:
            print('loads', flush=True)
            try:
                time.sleep(60)
            except BaseException as error:
                raise ImportError('a module is broken') from error
        self.create_timer(0.01, self._work)

    def _work(self):
        print('works', flush=True)
        if 'long' in sys.argv:
            time.sleep(1)
        print('is done', flush=True)

sys.exit(run_node(Tiny))
"""
STOPS = int(os.environ.get('HOID_TEST_STOPS', '3'))
_UP_S = 60.0
SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize('sign', SIGNALS)
def test_nodes_end_cleanly(sign: signal.Signals) -> None:
    status, _, errors = ended_by(sign)
    assert (status, errors) == (0, '')


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize('sign', SIGNALS)
def test_a_signal_lets_the_running_callback_return(sign: signal.Signals) -> None:
    assert ended_by(sign, 'long') == (0, 'is done\n', '')


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize('sign', SIGNALS)
def test_a_signal_ends_a_node_during_its_construction(sign: signal.Signals) -> None:
    assert ended_by(sign, 'load') == (EXIT_INTERRUPTED, '', '')


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize('loads', [('swallow',), ('garble',)], ids=str)
def test_an_interrupt_that_a_library_suppresses_or_replaces_ends_the_node(
    loads: tuple[str, ...],
) -> None:
    assert ended_by(signal.SIGINT, *loads) == (EXIT_INTERRUPTED, '', '')


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize('seed', range(STOPS))
def test_any_number_of_interrupts_ends_a_starting_node(seed: int) -> None:
    """As under `ros2 launch`, where the terminal and launch each send one."""
    rng = np.random.default_rng(seed)
    with real_node() as process:
        time.sleep(rng.uniform(0.0, 2.0))
        status, errors = interrupted(process, rng)
    assert errors == ''
    assert status in {0, EXIT_INTERRUPTED}


@pytest.mark.parametrize('seed', range(STOPS))
def test_any_number_of_interrupts_ends_a_running_node(seed: int, probe: Probe) -> None:
    diagnostics = probe.collect(DiagnosticArray, '/diagnostics', wait=False)
    with real_node() as process:
        probe.spin_until(lambda: bool(diagnostics), 'the node does not start', _UP_S)
        assert interrupted(process, np.random.default_rng(seed)) == (0, '')


@pytest.mark.usefixtures('domain_id')
def test_a_node_that_cannot_start_reports_why_in_one_line() -> None:
    assert failure('fail') == ['error: the focal length is 0; calibrate the camera']


@pytest.mark.usefixtures('domain_id')
def test_arguments_that_ros_refuses_are_reported_in_one_line() -> None:
    errors = failure('--ros-args', '-r', '__ns:=/two words')
    assert errors[-1].startswith('error: ')
    assert "'-r __ns:=/two words'" in errors[-1]
    assert 'Traceback' not in ''.join(errors)


@pytest.mark.usefixtures('domain_id')
@pytest.mark.skipif(os.geteuid() != 0, reason='only root can mount a small /dev/shm')
def test_a_node_without_shared_memory_reports_it() -> None:
    """As in a container with a small /dev/shm."""
    small = 'mount -t tmpfs -o size=1m tmpfs /dev/shm && exec "$@"'
    with real_node('unshare', '-m', 'bash', '-c', small, 'bash') as process:
        assert process.stderr is not None
        before = list(takewhile(lambda line: ': active, waiting for ' not in line, process.stderr))
        interrupted(process, np.random.default_rng(0))
    (said,) = (line for line in before if 'Fast DDS got no shared memory for images' in line)
    assert '[WARN]' in said
    assert 'has 0 MB free; a container needs --shm-size=1g' in said


def failure(*arguments: str) -> list[str]:
    """Return the error lines of a node that cannot start."""
    argv = [sys.executable, '-c', NODE, *arguments]
    result = subprocess.run(argv, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == EXIT_CONFIG
    return result.stderr.splitlines()


def ended_by(sign: signal.Signals, *arguments: str) -> tuple[int, str, str]:
    """Send a signal after a node's first line; return its status, further output and errors."""
    argv = [sys.executable, '-c', NODE, *arguments]
    pipe = subprocess.PIPE
    with subprocess.Popen(argv, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline()
        process.send_signal(sign)
        try:
            output, errors = process.communicate(timeout=20)
        finally:
            process.kill()
    return process.returncode, output, errors


@contextmanager
def real_node(*prefix: str) -> Iterator[subprocess.Popen[str]]:
    """Start the executable of a real node, as launch does, after the words of a prefix.

    It starts with SIGINT blocked: no program can handle a signal before its first instruction.
    """
    program = str(executable('hoid_filter', 'hoid_filter_node'))
    argv = [*prefix, program, '--ros-args', '-p', 'strategy:=none']
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process = subprocess.Popen(argv, stderr=subprocess.PIPE, text=True)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    try:
        yield process
    finally:
        process.kill()


def interrupted(process: subprocess.Popen[str], rng: np.random.Generator) -> tuple[int, str]:
    """Interrupt a process at least twice, until it ends; return its status and errors."""
    for _ in range(2):
        process.send_signal(signal.SIGINT)
        time.sleep(rng.choice((0.0, 0.01)))
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        with suppress(subprocess.TimeoutExpired):
            process.wait(rng.uniform(0.0, 0.1))
    return process.returncode, without_start(process.communicate()[1])


def without_start(errors: str) -> str:
    """Return the lines of a log without the one that says what the node waits for."""
    lines = errors.splitlines(keepends=True)
    return ''.join(line for line in lines if ': active, waiting for ' not in line)


def test_other_users_cannot_read_the_shared_memory_of_a_node(start: Start, probe: Probe) -> None:
    node = start('rgbd_slam', 'rgbd_slam_node')
    SlamPeer(probe).begin()
    (pid,) = node.pids.values()
    opened = {str(path.readlink()) for path in Path(f'/proc/{pid}/fd').iterdir()}
    segments = [lock for lock in opened if re.search(r'/fastrtps_[0-9a-f]+_el$', lock)]
    assert segments
    for lock in segments:
        assert Path(lock.removesuffix('_el')).stat().st_mode & 0o077 == 0
