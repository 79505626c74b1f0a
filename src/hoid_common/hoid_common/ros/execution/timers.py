"""Timers whose period is a parameter that may change at run time."""

from __future__ import annotations

from rclpy.timer import Timer

from hoid_common.values import NS_PER_S


def set_period(timer: Timer, period_s: float) -> None:
    """Change the period (s) of a timer; a changed period starts now."""
    period_ns = round(period_s * NS_PER_S)
    if timer.timer_period_ns != period_ns:
        timer.timer_period_ns = period_ns
        timer.reset()
