"""Times on /clock that rclpy cannot take, and would end the node for."""

from __future__ import annotations

import logging
import time

from rclpy.time_source import TimeSource
from rosgraph_msgs.msg import Clock

from hoid_common.throttle import Throttle

_PERIOD_S = 5.0
_logger = logging.getLogger(__name__)
_throttle = Throttle(_PERIOD_S)
_take = TimeSource.clock_callback


def refuse_times_before_1970() -> None:
    """Have all nodes of this process that go by /clock leave such times out, and say so."""
    TimeSource.clock_callback = _take_or_refuse


def _take_or_refuse(source: TimeSource, msg: Clock) -> None:
    if msg.clock.sec >= 0:
        _take(source, msg)
    elif (skipped := _throttle.allow('refused', time.monotonic())) is not None:
        _logger.warning(
            '/clock says %d s, which no time can be: left out (%d times before)',
            msg.clock.sec, skipped,
        )  # fmt: skip
