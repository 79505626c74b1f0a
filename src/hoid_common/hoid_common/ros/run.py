"""Running a node: start, spinning, signals and exit status."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import signal
import sys
import time
from collections.abc import Callable
from threading import Event, Thread
from types import FrameType

import cv2
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.time_source import TimeSource
from rosgraph_msgs.msg import Clock

from hoid_common.errors import ConfigError, HoidError, prefixed
from hoid_common.log_throttle import LogThrottle
from hoid_common.process.entry import EXIT_CONFIG, EXIT_FAILED, EXIT_INTERRUPTED
from hoid_common.process.signals import FAILURE_SIGNAL, NODE_END_SIGNALS
from hoid_common.ros.execution.executor import SteadyExecutor

_EXIT_LIMIT_S = 10  # chosen, not tuned: twice the time in which a child process must end
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # options of mallopt, from glibc's malloc.h
_failure = Event()  # set when FAILURE_SIGNAL has arrived
# Chosen: freed memory that glibc keeps; a 1080p image with its depth takes 15 MB (decision 017).
_KEPT_BYTES = 64 << 20
_LOG_PERIOD_S = 5.0  # chosen: shortest time between two log lines
_logger = logging.getLogger(__name__)
_throttle = LogThrottle(_LOG_PERIOD_S)
_set_time = TimeSource.clock_callback


def run_node(make_node: Callable[[], Node]) -> int:
    """Create a node, run its callbacks until a signal or shutdown, and return the exit status.

    It is 0 if the signal comes while the node runs, and EXIT_INTERRUPTED before. A HoidError is
    printed in one line; if the node cannot be created, the status is EXIT_CONFIG, else
    EXIT_FAILED. The whole process changes: OpenCV uses one thread, glibc keeps freed memory,
    negative times on /clock are ignored, and SIGALRM ends the process 10 s after the node began to
    end.
    """
    _reduce_processor_load()
    ignore_negative_clock_times()
    interrupt = _Interrupt()
    try:
        with prefixed('', ConfigError, RuntimeError):  # rclpy's RCLError
            # rclpy's own handlers shut down the context in another thread while this one destroys
            # the node. Of 1200 exits with them, one crashed and three printed an error.
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        return _run(make_node, interrupt)
    except BaseException as error:
        if interrupt.came:  # code that is interrupted may have raised another error
            return EXIT_INTERRUPTED
        if isinstance(error, HoidError):
            sys.stderr.write(f'error: {" ".join(str(error).split())}\n')
            return EXIT_FAILED if interrupt.is_node_made else EXIT_CONFIG
        raise
    finally:
        # While the interpreter shuts down, Python's handlers do not exist any more, and a signal's
        # default action would kill the process.
        _handle(signal.SIG_IGN)


def _run(make_node: Callable[[], Node], interrupt: _Interrupt) -> int:
    node: Node | None = None
    executor = SteadyExecutor()
    try:
        node = make_node()
        interrupt.is_node_made = True
        executor.add_node(node)
        return _spin(executor, interrupt)
    except ExternalShutdownException:
        return 0
    except RuntimeError:
        # The context may have been shut down by another thread while the executor built its wait
        # set.
        if rclpy.ok():
            raise
        return 0
    finally:
        _handle(_note)
        limit_exit_time()
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()


def is_end_asked_for() -> bool:
    return sys.exc_info()[0] is None and not _failure.is_set()


class _Interrupt:
    """Raises KeyboardInterrupt at the first signal that ends a node, until `_handle` is called."""

    def __init__(self) -> None:
        self.came = self.is_node_made = False
        sys.unraisablehook = self._ignore_interrupt
        _handle(self._raise)

    def _raise(self, sign: int, frame: FrameType | None) -> None:
        _note(sign, frame)
        _handle(_note)
        self.came = True
        raise KeyboardInterrupt

    @staticmethod
    def _ignore_interrupt(error: sys.UnraisableHookArgs) -> None:
        """Ignore a KeyboardInterrupt in code that cannot raise, because `came` records it."""
        if not issubclass(error.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(error)


def _note(sign: int, _frame: FrameType | None) -> None:
    if sign == FAILURE_SIGNAL:
        _failure.set()


def _handle(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    for sign in NODE_END_SIGNALS:
        if sign != signal.SIGHUP or signal.getsignal(sign) is not signal.SIG_IGN:  # `nohup`
            signal.signal(sign, handler)


def _reduce_processor_load() -> None:
    """Limit OpenCV to one thread, and let glibc keep freed memory (decision 017).

    Idle threads of OpenCV wake up 3000 times a second. glibc returns the memory of each freed
    image to the kernel, which clears and maps all pages again: this doubles the processor time for
    receiving an image.
    """
    cv2.setNumThreads(1)
    with contextlib.suppress(OSError, AttributeError):  # the C library is not glibc
        glibc = ctypes.CDLL('libc.so.6')
        for option in (_M_MMAP_THRESHOLD, _M_TRIM_THRESHOLD):
            glibc.mallopt(option, _KEPT_BYTES)


def _spin(executor: SteadyExecutor, interrupt: _Interrupt) -> int:
    ended = Event()
    hear_fd, tell_fd = os.pipe()
    os.set_blocking(tell_fd, False)

    def end() -> None:
        os.read(hear_fd, 1)
        ended.set()
        limit_exit_time()
        executor.wake()

    # Python's handlers do not run while this thread waits for messages in C code. But a signal is
    # written to the wake-up file descriptor at once, and another thread reads it.
    signal.set_wakeup_fd(tell_fd, warn_on_full_buffer=False)
    _handle(_note)
    if interrupt.came:  # in code that has swallowed the KeyboardInterrupt
        return EXIT_INTERRUPTED
    Thread(target=end, name='signals', daemon=True).start()
    while rclpy.ok() and not ended.is_set():
        executor.spin_once()
    return 0


def limit_exit_time() -> None:
    """Let SIGALRM end this process in 10 s, unless `signal.alarm(0)` is called before.

    Fast DDS 2.14 can deadlock in DomainParticipant::set_listener() when another participant is
    discovered while this one is destroyed. rclpy then holds the GIL, so that only a signal whose
    default action ends the process helps.
    """
    signal.alarm(_EXIT_LIMIT_S)


def ignore_negative_clock_times() -> None:
    TimeSource.clock_callback = _set_valid_time


def _set_valid_time(source: TimeSource, msg: Clock) -> None:
    if msg.clock.sec >= 0:
        _set_time(source, msg)
    elif _throttle.allow('negative', time.monotonic()) is not None:
        _logger.warning(
            '/clock: negative time of %d s ignored; check its publisher', msg.clock.sec
        )
