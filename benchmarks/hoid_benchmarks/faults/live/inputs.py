"""The filter and the SLAM node, sent wrong messages among good ones."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import rclpy
from hoid_msgs.msg import FeatureVerdicts

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.damage import Rng
from hoid_benchmarks.faults.live.mutations import mutated
from hoid_benchmarks.faults.live.sender import INPUTS, Sender
from hoid_bringup.live.node_specs import FILTER, SLAM, NodeOptions, node_specs
from hoid_bringup.live.ros_domain import own_domain
from hoid_bringup.live.supervisor import Supervisor
from hoid_common import topics

_START_S, _BACK_S = 60.0, 5.0
_MEMORY_FACTOR, _MEMORY_MB = 1.3, 30.0
_PARAMETERS: dict[str, dict[str, Any]] = {
    FILTER: {'strategy': 'hoid2d', 'detections.wait_s': 0.1},
    SLAM: {'dense.enabled': False, 'objects.enabled': False},
}


def message_cases(folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield one outcome for each input: all its seeds are sent to the same nodes.

    Every wrong message lies between good ones. Afterwards the nodes must be alive, odometry must
    come within five seconds in the same number of maps, and their memory must be as before.
    """
    folder.mkdir(parents=True)
    specs = node_specs(NodeOptions((FILTER, SLAM), parameters=_PARAMETERS), folder)
    with own_domain(), Supervisor(specs, log_dir=folder) as nodes:
        rclpy.init()
        node = rclpy.create_node('faults')
        try:
            yield from _inputs(Sender(node), nodes, folder, seeds)
        finally:
            node.destroy_node()
            rclpy.try_shutdown()


def _inputs(sender: Sender, nodes: Supervisor, folder: Path, seeds: range) -> Iterator[Outcome]:
    if not sender.is_tracking_within(_START_S):
        yield Outcome('messages', seeds.start, 'the nodes do not track good messages')
        return
    for _ in range(30):
        sender.send()
    for topic in INPUTS:
        nodes.poll()
        pids, before_mb, start_s = nodes.pids, _memory_mb(nodes), time.monotonic()
        num_maps = sender.status.maps if sender.status else 0
        _send_wrong(sender, topic, np.random.default_rng(seeds.start), len(seeds))
        complaint = _after(sender, nodes, pids, num_maps) or _grown(nodes, before_mb)
        complaint = complaint or _tracebacks(folder)
        wall_s, peak_mb = time.monotonic() - start_s, max(_memory_mb(nodes).values(), default=0.0)
        kind = f'{len(seeds)} messages on {topic}'
        yield Outcome(kind, seeds.start, complaint, wall_s=wall_s, peak_mb=peak_mb)


def _send_wrong(sender: Sender, topic: str, rng: Rng, number: int) -> None:
    for _ in range(number):
        good = sender.send()
        if topic == topics.FEATURES and sender.features is not None:
            sender.features.header = good[topics.RGB_IMAGE].header
            good[topic] = sender.features
        if topic == topics.FEATURE_VERDICTS:
            header = good[topics.RGB_IMAGE].header
            good[topic] = FeatureVerdicts(header=header, dynamic=[0, 1] * 500)
        sender.publishers[topic].publish(mutated(good[topic], rng))


def _after(sender: Sender, nodes: Supervisor, pids: dict[str, int], num_maps: int) -> str:
    if exits := nodes.poll():
        return '; '.join(map(str, exits))
    if nodes.pids != pids:
        return 'a node was started anew'
    if not sender.is_tracking_within(_BACK_S):
        return f'no odometry for {_BACK_S:g} s of good messages'
    now = sender.status.maps if sender.status else 0
    return '' if now <= num_maps else f'{now} maps where there were {num_maps}'


def _grown(nodes: Supervisor, before_mb: dict[str, float]) -> str:
    for name, now_mb in _memory_mb(nodes).items():
        if now_mb > _MEMORY_FACTOR * before_mb[name] + _MEMORY_MB:
            return f'{name} has {now_mb:.0f} MB where it had {before_mb[name]:.0f}'
    return ''


def _memory_mb(nodes: Supervisor) -> dict[str, float]:
    return {
        name: psutil.Process(pid).memory_info().rss / 2**20 for name, pid in nodes.pids.items()
    }


def _tracebacks(folder: Path) -> str:
    for log in folder.glob('*.log'):
        if 'Traceback' in log.read_text(errors='replace'):
            return f'a traceback of {log.stem}'
    return ''
