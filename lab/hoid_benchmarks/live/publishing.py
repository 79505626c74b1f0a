"""Scenario `publish`: what publishing path, points and keyframes of a large map costs.

A map of 100 keyframes is driven and tiled to the wanted sizes. A node in this process publishes
it to subscribers in another one.
"""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from statistics import median
from typing import Any, NamedTuple, Self

import rclpy
from nav_msgs.msg import Path
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from hoid_bags.live.ros_session import ros_session
from hoid_benchmarks.building.growth import SIZES, driven_map
from hoid_benchmarks.building.report import Outcome
from hoid_benchmarks.building.tiled_map import tiled_to
from hoid_benchmarks.building.world.floors import Building
from hoid_bringup.live.ros_domain import own_domain
from hoid_common import topics
from hoid_common.errors import InputError
from hoid_common.ros import qos
from hoid_common.ros.execution.executor import SteadyExecutor
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.ros.map_outputs import MapOutputs
from rgbd_slam.session import SlamSession
from rgbd_slam.store.map_file import MapFile

_TYPES: dict[str, type[Any]] = {
    topics.PATH: Path,
    topics.MAP_POINTS: PointCloud2,
    topics.KEYFRAMES: MarkerArray,
}
_NUM_ROUNDS = 5  # chosen: each publishes all three topics
_LIMIT_S = 60.0  # for a message to arrive
_IDLE_S = 3.0  # chosen: three periods
_POLL_S = 0.2  # chosen: rarely, as waking takes time
_TICK_S = 0.5e-3  # chosen: period of the thread that measures how long it has to wait
_COLUMNS = {
    'keyframes': 'd',
    'points': 'd',
    'MB': '.1f',
    'tracking ms': '.1f',
    'other threads ms': '.0f',
    'wait ms': '.1f',
    'idle wait ms': '.1f',
    'unheard ms': '.2f',
}


class _Idle(NamedTuple):
    """A node without anything to publish."""

    cpu_share: float  # of the tracking thread
    wait_s: float


class _Round(NamedTuple):
    """One publication of all topics."""

    num_bytes: int
    tracking_s: float  # CPU time of the tracking thread
    others_s: float  # CPU time of all other threads, those of the middleware included
    wall_s: float
    wait_s: float  # longest time for which another thread could not run


def publishing(seed: int, sizes: Sequence[int] = SIZES) -> Outcome:
    """Return the CPU times of publishing the whole map once, for each map size.

    Columns: the time of the tracking thread; that of all other threads; the longest time for which
    a thread could not run, in the best round, and while nothing is published; and the time of the
    tracking thread in a second without subscribers.
    """
    _, _, base = driven_map(Building(seed=seed), seed)
    rows = [_measured(tiled_to(base, size, seed)) for size in sizes]
    return Outcome('publish', 'Publishing the map (CPU time)', _COLUMNS, rows)


def _measured(content: MapFile) -> dict[str, Any]:
    config = SlamNodeConfig()
    session = SlamSession(content.camera, config, RobotFrames())
    session.map.load(content)
    session.map.atlas.keyframes.is_loaded[:] = False  # so that they are part of the path
    row: dict[str, Any] = {
        'keyframes': len(content.map),
        'points': len(content.map.position_m),
    }
    with own_domain(), ros_session('publishing') as node:
        outputs = MapOutputs(node, config, lambda: session)
        rounds = _Rounds(node, session)
        row['unheard ms'] = rounds.unheard_ms()
        with _subscribers() as arrived:
            row |= rounds.measured(arrived)
        outputs.close()
    return row


class _Rounds:
    """Spins the node and measures; the thread that calls it is the tracking thread."""

    def __init__(self, node: Node, session: SlamSession) -> None:
        self._session = session
        self._executor = SteadyExecutor()
        self._executor.add_node(node)

    def unheard_ms(self) -> float:
        """Return the CPU time of this thread per second while the map changes unheard."""
        return 1e3 * self._idle(changing=True).cpu_share

    def measured(self, arrived: Connection) -> dict[str, float]:
        """Return the times of a round and the size of its messages."""
        self._round(arrived)  # the messages of subscribers that join
        idle = self._idle(changing=False)
        rounds = [self._round(arrived) for _ in range(_NUM_ROUNDS)]
        return {
            'MB': rounds[0].num_bytes / 1e6,
            'tracking ms': 1e3 * median(r.tracking_s - idle.cpu_share * r.wall_s for r in rounds),
            'other threads ms': 1e3 * median(r.others_s for r in rounds),
            'wait ms': 1e3 * min(r.wait_s for r in rounds),
            'idle wait ms': 1e3 * idle.wait_s,
        }

    def _idle(self, *, changing: bool) -> _Idle:
        start_s, end_s = time.thread_time(), time.monotonic() + _IDLE_S
        with _Ticker() as ticker:
            while (left_s := end_s - time.monotonic()) > 0:
                self._session.map.has_changed |= changing
                self._executor.spin_once(timeout_sec=min(left_s, _POLL_S))
        return _Idle((time.thread_time() - start_s) / _IDLE_S, ticker.longest_s)

    def _round(self, arrived: Connection) -> _Round:
        """Change the map, and spin until a message of each topic has arrived."""
        sizes: dict[str, int] = {}
        self._session.map.has_changed = True
        own_s, all_s, wall_s = time.thread_time(), time.process_time(), time.monotonic()
        with _Ticker() as ticker:
            while sizes.keys() != _TYPES.keys():
                self._executor.spin_once(timeout_sec=_POLL_S)
                while arrived.poll():
                    topic, size = arrived.recv()
                    sizes[topic] = size
                if time.monotonic() > wall_s + _LIMIT_S:
                    raise InputError(f'messages do not arrive; only {sorted(sizes)} do')
        own_s = time.thread_time() - own_s
        return _Round(
            sum(sizes.values()),
            own_s,
            time.process_time() - all_s - own_s - ticker.cpu_s,
            time.monotonic() - wall_s,
            ticker.longest_s,
        )


class _Ticker:
    """Measures in another thread how long it has to wait for Python's interpreter lock."""

    def __init__(self) -> None:
        self.longest_s = self.cpu_s = 0.0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._tick)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _tick(self) -> None:
        last_s = time.perf_counter()
        while not self._ended.wait(_TICK_S):
            now_s = time.perf_counter()
            self.longest_s = max(self.longest_s, now_s - last_s - _TICK_S)
            last_s = now_s
        self.cpu_s = time.thread_time()


@contextmanager
def _subscribers() -> Iterator[Connection]:
    """Start a process that subscribes to all topics and reports each message."""
    context = multiprocessing.get_context('spawn')
    receiving, sending = context.Pipe(duplex=False)
    process = context.Process(target=_subscribe, args=(sending,), daemon=True)
    process.start()
    try:
        yield receiving
    finally:
        process.terminate()
        process.join()


def _subscribe(arrived: Connection) -> None:
    rclpy.init()
    node = Node('subscribers')
    for topic, type_ in _TYPES.items():

        def report(data: bytes, topic: str = topic) -> None:
            arrived.send((topic, len(data)))

        node.create_subscription(type_, topic, report, qos.LATCHED, raw=True)
    executor = SteadyExecutor()
    executor.add_node(node)
    with suppress(ExternalShutdownException):
        executor.spin()
