"""The entry point of nodes, in a process: how they end and how they say that they cannot start."""

import signal
import subprocess
import sys

import pytest

NODE = """
import sys
from rclpy.node import Node
from hoid_common.errors import ConfigError
from hoid_common.ros.run import run_node

class Tiny(Node):
    def __init__(self):
        super().__init__('tiny')
        if len(sys.argv) > 1:
            raise ConfigError('the focal length is 0; calibrate the camera')
        self.create_timer(0.01, lambda: print('spins', flush=True) or self.destroy_timer)

sys.exit(run_node(Tiny))
"""


@pytest.mark.usefixtures('domain_id')
@pytest.mark.parametrize('sign', [signal.SIGINT, signal.SIGTERM])
def test_nodes_end_cleanly(sign: signal.Signals) -> None:
    process = subprocess.Popen(
        [sys.executable, '-c', NODE], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == 'spins\n'
    process.send_signal(sign)
    _, errors = process.communicate(timeout=20)
    assert (process.returncode, errors) == (0, '')


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
