"""One case of the live report: a bag is played to the nodes, which are measured meanwhile."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.live.ros_session import ros_session
from hoid_benchmarks.faults.live.node_harness import MAPPER, member_pids
from hoid_benchmarks.live.cases import LiveCase
from hoid_benchmarks.live.listener import Listener
from hoid_benchmarks.live.usage import Usage, UsageMeter
from hoid_bringup.live.node_specs import DETECTOR, FILTER, SCENE, SLAM, node_specs
from hoid_bringup.live.replay_plan import (
    ReplayConfig,
    camera_info_topic,
    node_options,
    player_spec,
)
from hoid_bringup.live.ros_domain import own_domain
from hoid_bringup.live.supervisor import Supervisor
from hoid_common.errors import InputError
from hoid_common.io.files import scratch_folder
from hoid_common.process.shared_memory import clean_shared_memory

PROCESSES = (DETECTOR, FILTER, SLAM, MAPPER, SCENE)
"""The processes of the suite in the order of the report."""
_RECORDED_HZ = 30.0  # of all recordings that are used
_STRATEGY, _MODEL = 'filter.strategy', 'detector.model'
_READY_S = 90.0  # limit; nodes start in seconds, on a busy computer in tens of them
_WARM_UP_S = 3.0  # chosen: first calls, the first map
_TICK_S = 0.25  # chosen


class LiveResult(NamedTuple):
    """What the processes of a case used."""

    usage: dict[str, Usage]  # by process
    latency_ms: tuple[float, float]  # image to odometry: median, 95th percentile
    num_images: int  # that got odometry
    num_shown: int  # that were published
    duration_s: float


def run_case(
    case: LiveCase, bag: BagSequence, detector: str | None, folder: Path, limit_s: float
) -> LiveResult:
    """Play a bag to the nodes for a time, and measure their processes after a warm-up.

    Args:
        case: What to measure.
        bag: The recording, of 30 images per second.
        detector: Model of the detector; None: the one that the nodes find.
        folder: Folder for files and logs.
        limit_s: Longest time to play.

    Raises:
        HoidError: A node does not start or ends early.
    """
    values = {_STRATEGY: case.strategy, **({_MODEL: detector} if detector else {})}
    config = ReplayConfig(
        rate=case.rate_hz / _RECORDED_HZ,
        run=ReplayConfig().run.updated(values),
    )
    with scratch_folder(folder, 'live') as scratch, own_domain(), _on_cores(case.num_cores):
        try:
            nodes = node_specs(node_options(bag, config, scratch.resolve()))
            with (
                ros_session('hoid_live') as node,
                Supervisor(nodes, log_dir=folder / 'logs') as running,
            ):
                listener = Listener(node, camera_info_topic(bag).name, everything=case.everything)
                _await_nodes(listener, running, bag)
                player = player_spec(bag, config)
                with Supervisor([player], log_dir=folder / 'logs') as playing:
                    return _measured(listener, running, playing, limit_s)
        finally:
            clean_shared_memory()


def _await_nodes(listener: Listener, running: Supervisor, bag: BagSequence) -> None:
    topic = camera_info_topic(bag).name
    with BagReader(bag.path) as reader:
        camera_info = next(reader.messages([topic])).data
    end_s = time.monotonic() + _READY_S
    while MAPPER not in member_pids(running.pids):
        listener.spin(_TICK_S)
        if listener.is_connected():
            listener.send_camera(camera_info)
        _check(running)
        if time.monotonic() > end_s:
            raise InputError(f'nodes not ready after {_READY_S:g} s')


def _measured(
    listener: Listener, running: Supervisor, playing: Supervisor, limit_s: float
) -> LiveResult:
    """Measure from the first odometry on, until the bag or the time limit ends."""
    end_s = time.monotonic() + _READY_S
    while not listener.metrics.odometry_ns:
        listener.spin(_TICK_S)
        _check(running)
        if time.monotonic() > end_s:
            raise InputError(f'no odometry after {_READY_S:g} s')
    listener.spin(_WARM_UP_S)
    listener.metrics.published_ns.clear()
    listener.metrics.odometry_ns.clear()
    meter, start_s = UsageMeter(member_pids(running.pids)), time.monotonic()
    while playing.pids and time.monotonic() < start_s + limit_s:
        listener.spin(_TICK_S)
        _check(running)
        playing.poll()
    usage, duration_s = meter.read(), time.monotonic() - start_s
    latency_ms = listener.metrics.latency_ms()
    if not latency_ms:
        raise InputError('no odometry while it was measured: play a longer recording')
    return LiveResult(
        usage,
        (float(np.median(latency_ms)), float(np.percentile(latency_ms, 95))),
        len(latency_ms),
        len(listener.metrics.published_ns),
        duration_s,
    )


def _check(running: Supervisor) -> None:
    for ended in running.poll():
        raise InputError(str(ended))


@contextmanager
def _on_cores(count: int) -> Iterator[None]:
    """Let this process, and all that it starts in the block, use so many processor cores."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(before)[:count])
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
