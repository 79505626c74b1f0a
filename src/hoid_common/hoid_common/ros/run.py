"""The entry point of every node."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import Callable, Sequence
from threading import Event, Thread
from types import FrameType

import cv2
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from hoid_common.errors import ConfigError, HoidError
from hoid_common.process.entry import INTERRUPTED, REFUSED
from hoid_common.process.signals import ENDING
from hoid_common.ros.clocks import refuse_times_before_1970
from hoid_common.ros.execution.executor import SteadyExecutor

_EXIT_LIMIT_S = 10
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of glibc's malloc.h
_KEPT_BYTES = 64 << 20


def run_node(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Spin a node until SIGINT, SIGTERM or shutdown, and return the exit status.

    The first signal ends the node and the others do nothing. While the node is made it interrupts
    that, with status 130; later it lets the callback that runs return, so that nothing is left
    half done, with status 0. A HoidError from making the node and arguments that ROS refuses are
    said in one line, with status REFUSED.
    """
    _take_no_more_than_needed()
    refuse_times_before_1970()
    interrupt = _Interrupt()
    try:
        _init(args)
        return _run(make_node, interrupt)
    except BaseException as error:
        if interrupt.came:  # whatever the interrupted code has made of it
            return INTERRUPTED
        if isinstance(error, HoidError):
            sys.stderr.write(f'error: {" ".join(str(error).split())}\n')
            return REFUSED
        raise
    finally:
        # A handler in Python would be gone before the interpreter is, and the default one kills.
        _handle(signal.SIG_IGN)


def _init(args: Sequence[str] | None) -> None:
    try:
        # rclpy's own handlers end the context in another thread while this one takes the node
        # apart; of 1200 exits one crashed of that and three wrote of it.
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # rclpy's RCLError
        raise ConfigError(str(error)) from error


def _run(make_node: Callable[[], Node], interrupt: _Interrupt) -> int:
    node: Node | None = None
    executor = SteadyExecutor()
    try:
        node = make_node()
        executor.add_node(node)
        return _spin(executor, interrupt)
    except ExternalShutdownException:
        return 0
    except RuntimeError:
        # Another thread may end the context just as the executor makes its wait set.
        if rclpy.ok():
            raise
        return 0
    finally:
        _handle(_do_nothing)
        limit_exit_time()
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()


class _Interrupt:
    """Lets the first SIGINT or SIGTERM raise KeyboardInterrupt, until `_handle` is called."""

    def __init__(self) -> None:
        self.came = False
        sys.unraisablehook = self._forgive
        _handle(self._raise)

    def _raise(self, _sign: int, _frame: FrameType | None) -> None:
        _handle(_do_nothing)
        self.came = True
        raise KeyboardInterrupt

    @staticmethod
    def _forgive(error: sys.UnraisableHookArgs) -> None:
        """Say nothing of an interrupt that hit code which cannot raise; `came` tells of it."""
        if not issubclass(error.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(error)


def _do_nothing(_sign: int, _frame: FrameType | None) -> None:
    pass


def _handle(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    for sign in (signal.SIGINT, *ENDING):
        if sign != signal.SIGHUP or signal.getsignal(sign) is not signal.SIG_IGN:  # `nohup`
            signal.signal(sign, handler)


def _take_no_more_than_needed() -> None:
    """Keep this process from costing others time for nothing.

    Idle threads of OpenCV ask for the processor 3000 times a second. glibc gives a freed image
    back to the kernel, which then clears and maps every page of the next: twice the time that it
    takes to receive an image.
    """
    cv2.setNumThreads(1)
    with contextlib.suppress(OSError, AttributeError):  # not glibc
        glibc = ctypes.CDLL('libc.so.6')
        for option in (_M_MMAP_THRESHOLD, _M_TRIM_THRESHOLD):
            glibc.mallopt(option, _KEPT_BYTES)


def _spin(executor: SteadyExecutor, interrupt: _Interrupt) -> int:
    """Run callbacks until shutdown or the first signal, and return the exit status."""
    ended = Event()
    hear_fd, tell_fd = os.pipe()
    os.set_blocking(tell_fd, False)

    def end() -> None:
        os.read(hear_fd, 1)
        ended.set()
        limit_exit_time()
        executor.wake()

    # A Python handler would not run while this thread waits for messages; a byte comes through.
    signal.set_wakeup_fd(tell_fd, warn_on_full_buffer=False)
    _handle(_do_nothing)
    if interrupt.came:  # in code that let nothing through
        return INTERRUPTED
    Thread(target=end, name='signals', daemon=True).start()
    while rclpy.ok() and not ended.is_set():
        executor.spin_once()
    return 0


def limit_exit_time() -> None:
    """Have this process ended by SIGALRM in 10 s; `signal.alarm(0)` takes that back.

    Fast DDS 2.14 deadlocks in DomainParticipant::set_listener() when another participant's news
    come just as this one is destroyed. rclpy holds the GIL there, so only a signal ends that.
    """
    signal.alarm(_EXIT_LIMIT_S)
