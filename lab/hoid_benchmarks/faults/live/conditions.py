"""Clocks that jump, a detector that is too slow, a machine whose cores are all busy."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

from rosgraph_msgs.msg import Clock

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.node_harness import (
    CaseResult,
    NodeHarness,
    Setup,
    odometry_result,
    running_nodes,
)
from hoid_benchmarks.faults.live.sender import Sender
from hoid_bringup.live.node_specs import FILTER, SLAM
from hoid_common import topics
from hoid_common.ros import conversions
from hoid_common.values import NS_PER_S

_JUMPS_S = (0.5, -0.5, 5.0, -5.0, 60.0, -60.0, 3600.0, -3600.0, 86400.0, -86400.0)
_WHILE_S = 3.0
# Of images with odometry. A session for another camera starts in a second or two.
_LEAST_SHARE, _LEAST_BUSY_SHARE, _LEAST_CHANGED_SHARE = 0.9, 0.3, 0.5


def clock_cases(harness: NodeHarness, seeds: range) -> Iterator[Outcome]:
    """Yield the outcomes of image stamps that jump once and continue from there."""
    for seed in seeds:
        jump_s = _JUMPS_S[seed % len(_JUMPS_S)]
        yield harness.outcome('a clock that jumps', seed, partial(_jump, harness.sender, jump_s))


def calibration_cases(harness: NodeHarness, seeds: range) -> Iterator[Outcome]:
    """Yield the outcomes of a camera_info that changes to another calibration and back."""
    for seed in seeds:
        yield harness.outcome(
            'a camera_info that changes', seed, partial(_recalibrate, harness.sender)
        )


def _recalibrate(sender: Sender) -> CaseResult:
    scene, before = sender.scene, sender.scene.camera
    scene.camera = replace(before, fx_px=1.1 * before.fx_px, fy_px=1.1 * before.fy_px)
    share = sender.send_for(2 * _WHILE_S)
    scene.camera = before
    return odometry_result(share, _LEAST_CHANGED_SHARE)


def sim_time_cases(folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield the outcomes of image stamps and a /clock that jump together."""
    with running_nodes(folder, Setup((FILTER, SLAM), sim_time=True)) as harness:
        for seed in seeds:
            jump_s = _JUMPS_S[seed % len(_JUMPS_S)]

            def jump_with_clock(jump_s: float = jump_s) -> CaseResult:
                seen = _jump(harness.sender, jump_s)
                for _ in range(10):
                    now = conversions.stamp_to_msg(harness.sender.now_ns())
                    harness.sender.publish(topics.CLOCK, Clock(clock=now))
                    harness.sender.send()
                return seen

            yield harness.outcome('a /clock that jumps', seed, jump_with_clock)


def _jump(sender: Sender, jump_s: float) -> CaseResult:
    sender.ahead_ns += round(jump_s * NS_PER_S)
    return CaseResult(note=f'by {jump_s:g} s')


def load_cases(harness: NodeHarness, seeds: range) -> Iterator[Outcome]:
    """Yield the outcomes of a detector ten times too slow and of a busy machine."""
    for seed in seeds:
        yield harness.outcome(
            'a detector ten times too slow', seed, partial(_slow, harness.sender)
        )
        yield harness.outcome('all cores busy', seed, partial(_busy, harness.sender))


def _slow(sender: Sender) -> CaseResult:
    sender.is_detector_slow = True
    share = sender.send_for(_WHILE_S)
    sender.is_detector_slow = False
    return odometry_result(share, _LEAST_SHARE)


def _busy(sender: Sender) -> CaseResult:
    with _spinning(os.cpu_count() or 1):
        share = sender.send_for(_WHILE_S)
    return odometry_result(share, _LEAST_BUSY_SHARE)


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
