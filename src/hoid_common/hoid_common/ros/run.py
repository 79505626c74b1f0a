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

    A HoidError from making the node is said in one line and gives status 1.
    """
    rclpy.init(args=args)
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
        sys.stderr.write(f'error: {error}\n')
        return 1
    finally:
        # Once in a few hundred exits destroy_node() never returns and holds the GIL; only a signal
        # ends that.
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(_EXIT_LIMIT_S)
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
