"""The entry point of every node."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from hoid_common.errors import HoidError
from hoid_common.ros.executor import SteadyExecutor

_EXIT_LIMIT_S = 10


def run_node(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Spin a node until SIGINT, SIGTERM or shutdown, and return the exit status.

    A HoidError from making the node and arguments that ROS refuses are said in one line and give
    status 1.
    """
    try:
        rclpy.init(args=args)
    except RuntimeError as error:  # rclpy's RCLError
        return _failed(error)
    node: Node | None = None
    executor = SteadyExecutor()
    try:
        node = make_node()
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RuntimeError:
        # A signal may end the context just as the executor makes its wait set.
        if rclpy.ok():
            raise
    except HoidError as error:
        return _failed(error)
    finally:
        limit_exit_time()
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def limit_exit_time() -> None:
    """Have this process ended if it is still there in 10 s; `signal.alarm(0)` takes that back.

    Once in a few hundred exits destroy_node() never returns and holds the GIL; only a signal ends
    that.
    """
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(_EXIT_LIMIT_S)


def _failed(error: Exception) -> int:
    sys.stderr.write(f'error: {" ".join(str(error).split())}\n')
    return 1
