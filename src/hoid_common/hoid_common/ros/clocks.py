"""Protection against negative times on /clock, for which rclpy raises and the node would die."""

from __future__ import annotations

import logging
import time

from rclpy.time_source import TimeSource
from rosgraph_msgs.msg import Clock

from hoid_common.log_throttle import LogThrottle

_LOG_PERIOD_S = 5.0  # chosen: shortest time between two log lines
_logger = logging.getLogger(__name__)
_throttle = LogThrottle(_LOG_PERIOD_S)
_set_time = TimeSource.clock_callback


def ignore_negative_clock_times() -> None:
    TimeSource.clock_callback = _set_valid_time


def _set_valid_time(source: TimeSource, msg: Clock) -> None:
    if msg.clock.sec >= 0:
        _set_time(source, msg)
    elif _throttle.allow('negative', time.monotonic()) is not None:
        _logger.warning(
            '/clock: negative time of %d s ignored; check its publisher', msg.clock.sec
        )
