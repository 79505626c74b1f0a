"""The entry point of nodes, in a process: how they end and how they say that they cannot start."""

import signal
import subprocess
import sys

import pytest

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
        self.create_timer(0.01, self._work)

    def _work(self):
        print('works', flush=True)
        if 'long' in sys.argv:
            time.sleep(1)
        print('is done', flush=True)

sys.exit(run_node(Tiny))
"""
SIGNALS = [signal.SIGINT, signal.SIGTERM]


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize('sign', SIGNALS)
def test_nodes_end_cleanly(sign: signal.Signals) -> None:
    status, _, errors = ended_by(sign)
    assert (status, errors) == (0, '')


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize('sign', SIGNALS)
def test_a_signal_lets_the_callback_that_runs_return(sign: signal.Signals) -> None:
    assert ended_by(sign, 'long') == (0, 'is done\n', '')


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize('sign', SIGNALS)
def test_a_signal_ends_a_node_that_is_being_made(sign: signal.Signals) -> None:
    assert ended_by(sign, 'load') == (0, '', '')


@pytest.mark.usefixtures('domain_id')
def test_a_node_that_cannot_start_says_why_in_one_line() -> None:
    assert failure('fail') == ['error: the focal length is 0; calibrate the camera']


@pytest.mark.usefixtures('domain_id')
def test_arguments_that_ros_refuses_are_said_in_one_line() -> None:
    said = failure('--ros-args', '-r', '__ns:=/two words')
    assert said[-1].startswith('error: ')
    assert "'-r __ns:=/two words'" in said[-1]
    assert 'Traceback' not in ''.join(said)


def failure(*arguments: str) -> list[str]:
    """Return what a node says that cannot start."""
    argv = [sys.executable, '-c', NODE, *arguments]
    result = subprocess.run(argv, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 1
    return result.stderr.splitlines()


def ended_by(sign: signal.Signals, *arguments: str) -> tuple[int, str, str]:
    """Send a node a signal at its first line; return its status, further output and errors."""
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
