"""Clocks that jump, a detector that is too slow, a machine with work for all its cores."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from rosgraph_msgs.msg import Clock

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.sender import Sender
from hoid_benchmarks.faults.live.stage import Seen, Setup, Stage, shared, staged
from hoid_bringup.live.node_specs import FILTER, SLAM
from hoid_common import topics
from hoid_common.ros import conversions
from hoid_common.values import NS_PER_S

_JUMPS_S = (0.5, -0.5, 5.0, -5.0, 60.0, -60.0, 3600.0, -3600.0, 86400.0, -86400.0)
_WHILE_S = 3.0
_LEAST_SHARE, _LEAST_BUSY_SHARE = 0.9, 0.3  # of the images that odometry must come of


def clock_cases(stage: Stage, seeds: range) -> Iterator[Outcome]:
    """Yield the outcomes of stamps that leap, and then go on from there."""
    for seed in seeds:
        jump_s = _JUMPS_S[seed % len(_JUMPS_S)]
        yield stage.outcome('a clock that jumps', seed, partial(_jump, stage.sender, jump_s))


def sim_time_cases(folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield the same by a /clock that leaps as well."""
    with staged(folder, Setup((FILTER, SLAM), has_scene=False, sim_time=True)) as stage:
        for seed in seeds:
            jump_s = _JUMPS_S[seed % len(_JUMPS_S)]

            def leap(jump_s: float = jump_s) -> Seen:
                seen = _jump(stage.sender, jump_s)
                for _ in range(10):
                    now = conversions.stamp_to_msg(stage.sender.now_ns())
                    stage.sender.publish(topics.CLOCK, Clock(clock=now))
                    stage.sender.send()
                return seen

            yield stage.outcome('a /clock that jumps', seed, leap)


def _jump(sender: Sender, jump_s: float) -> Seen:
    sender.ahead_ns += round(jump_s * NS_PER_S)
    return Seen(note=f'by {jump_s:g} s')


def load_cases(stage: Stage, seeds: range) -> Iterator[Outcome]:
    """Yield the outcomes of a detector ten times too slow and of a machine with work for all."""
    for seed in seeds:
        yield stage.outcome('a detector ten times too slow', seed, partial(_slow, stage.sender))
        yield stage.outcome('all cores busy', seed, partial(_busy, stage.sender))


def _slow(sender: Sender) -> Seen:
    sender.is_detector_slow = True
    share = sender.send_for(_WHILE_S)
    sender.is_detector_slow = False
    return shared(share, _LEAST_SHARE)


def _busy(sender: Sender) -> Seen:
    with _spinning(os.cpu_count() or 1):
        share = sender.send_for(_WHILE_S)
    return shared(share, _LEAST_BUSY_SHARE)


@contextmanager
def _spinning(number: int) -> Iterator[None]:
    children = [
        subprocess.Popen([sys.executable, '-c', 'while True: pass'], process_group=0)
        for _ in range(number)
    ]
    try:
        yield
    finally:
        for child in children:
            child.kill()
            child.wait()
