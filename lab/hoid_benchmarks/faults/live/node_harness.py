"""Running nodes with a simulated camera, and the checks that follow every injected fault."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import psutil
import rclpy
from rclpy.parameter import Parameter

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.sender import OWN_DETECTIONS, RATE_HZ, Scene, Sender
from hoid_benchmarks.faults.live.services import Services
from hoid_benchmarks.faults.live.watched_nodes import WatchedNodes, watched
from hoid_bringup.live.node_specs import (
    DETECTOR,
    FILTER,
    SCENE,
    SLAM,
    NodeOptions,
    node_specs,
)
from hoid_bringup.live.ros_domain import own_domain
from hoid_bringup.live.supervisor import family_mb
from hoid_common import topics
from hoid_common.errors import HoidError
from hoid_detector.model.model_path import SYNTHETIC

START_S, BACK_S, _ALL_S = 60.0, 5.0, 10.0
_WARM_IMAGES = 30
_MEMORY_FACTOR = 1.3
_YOUNG_MB = 60.0  # additional growth allowed before the nodes have settled
_SETTLE_S, _SETTLED_MB = 15.0, 1.0
MAPS = 'maps'
MAPPER = 'mapper'
_NAMES = {
    DETECTOR: ((topics.DETECTIONS, OWN_DETECTIONS),),
    SLAM: ((topics.VISUAL_ODOM, topics.ODOM),),
}
ALL_OUTPUTS = (topics.ODOM, OWN_DETECTIONS, topics.TRACKED_OBJECTS)


@dataclass(frozen=True)
class Setup:
    """Which nodes run, how they are configured, and what the sender publishes."""

    nodes: tuple[str, ...] = (DETECTOR, FILTER, SLAM, SCENE)
    scene: Scene | None = None  # None: a still camera
    rate_hz: float = RATE_HZ
    is_compressed: bool = False
    restart: bool = False  # restart nodes that have ended
    model: str = SYNTHETIC  # of the detector
    sim_time: bool = False
    is_foreign: bool = False  # boxes as vision_msgs, wheel odometry on /tf
    # Environment variables of the nodes.
    environment: Mapping[str, str] = field(default_factory=dict)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Return the topics that are published for every image or every few images."""
        is_made = (True, DETECTOR in self.nodes, SCENE in self.nodes)
        return tuple(o for o, made in zip(ALL_OUTPUTS, is_made, strict=True) if made)

    def options(self, maps: Path) -> Iterator[NodeOptions]:
        """Yield the options of the nodes; the detector's output is remapped to its own topic."""
        image = {'input.compressed': self.is_compressed}
        parameters: dict[str, dict[str, Any]] = {
            DETECTOR: {'model': self.model, **image},
            FILTER: {
                'strategy': 'hoid2d', 'detections.wait_s': 0.1,
                'detections.as_vision_msgs': self.is_foreign, **image,
            },
            SLAM: {
                'map_directory': str(maps), 'checkpoint_period_s': 1.0,
                'frames.publish_odom_to_base': not self.is_foreign, **image,
            },
            SCENE: {'map_directory': str(maps), 'object_map.enabled': True, **image},
        }  # fmt: skip
        for node in self.nodes:
            yield NodeOptions(
                (node,), parameters=parameters, remappings=_NAMES.get(node, ()),
                use_sim_time=self.sim_time,
            )  # fmt: skip


class CaseResult(NamedTuple):
    """What a fault case observed while the fault was injected."""

    complaint: str = ''
    note: str = ''


class _State(NamedTuple):
    pids: Mapping[str, int]
    memory_mb: Mapping[str, float]
    maps: int


class NodeHarness:
    """The running nodes, and the simulated camera that publishes their inputs."""

    def __init__(self, setup: Setup, folder: Path, nodes: WatchedNodes, sender: Sender) -> None:
        self.setup, self.folder, self.nodes, self.sender = setup, folder, nodes, sender
        self.maps = folder / MAPS
        self.services = Services(sender, setup.nodes)
        self._settled_mb: Mapping[str, float] = {}

    def settle(self, limit_s: float) -> None:
        """Publish good images and request all services until the memory of the nodes is stable.

        Later cases may use up to 1.3 times that memory. If it is not stable within the limit (s),
        cases are compared with the memory before each of them.
        """
        now_mb = self._memory_mb()
        for _ in range(int(limit_s / _SETTLE_S)):
            before_mb = now_mb
            self.sender.send_for(_SETTLE_S)
            self.services.unanswered(_ALL_S)
            now_mb = self._memory_mb()
            if all(now_mb[name] < before_mb[name] + _SETTLED_MB for name in now_mb):
                self._settled_mb = now_mb
                return

    def outcome(
        self, kind: str, seed: int, inject: Callable[[], CaseResult], back_s: float = BACK_S
    ) -> Outcome:
        """Inject a fault, check the nodes afterwards, and return the outcome.

        All nodes must run, all outputs must be back within `back_s` without a new map, all
        services must respond, and memory must not have grown.
        """
        self.nodes.poll()
        before, start_s = self._state(), time.monotonic()
        complaint, note = inject()
        complaint = complaint or self._complaint(before, back_s)
        wall_s, peak_mb = time.monotonic() - start_s, max(self._memory_mb().values(), default=0.0)
        return Outcome(kind, seed, complaint, wall_s=wall_s, peak_mb=peak_mb, note=note)

    def _complaint(self, before: _State, back_s: float) -> str:
        if exits := self.nodes.poll():
            return '; '.join(map(str, exits))
        if self.nodes.pids != before.pids:
            return 'a node was restarted'
        # Outputs that odometry does not depend on may come later.
        for outputs, limit_s in ((self.setup.outputs[:1], back_s), (self.setup.outputs, _ALL_S)):
            if silent := self.sender.missing_outputs(limit_s, outputs):
                return (
                    f'no {", ".join(silent)} for {limit_s:g} s of good messages; '
                    f'{self.sender.latest_diagnostics()}'
                )
        if (maps := self._state().maps) > before.maps:
            return f'{maps} maps, {before.maps} before'
        if unanswered := self.services.unanswered(_ALL_S):
            return f'no response from {", ".join(unanswered)} within {_ALL_S:g} s'
        return self._grown(before.memory_mb) or self._tracebacks()

    def _state(self) -> _State:
        status = self.sender.status
        return _State(self.nodes.pids, self._memory_mb(), status.maps if status else 0)

    def _grown(self, before_mb: Mapping[str, float]) -> str:
        clean_mb, more_mb = (self._settled_mb, 0.0) if self._settled_mb else (before_mb, _YOUNG_MB)
        for name, now_mb in self._memory_mb().items():
            if now_mb > _MEMORY_FACTOR * clean_mb[name] + more_mb:
                return f'{name} uses {now_mb:.0f} MB, {clean_mb[name]:.0f} MB before'
        return ''

    def _memory_mb(self) -> dict[str, float]:
        return {name: family_mb(pid) for name, pid in self.nodes.pids.items()}

    def _tracebacks(self) -> str:
        for log in self.folder.glob('*.log'):
            _, found, rest = log.read_text(errors='replace').partition('Traceback')
            if found:
                error = next((line for line in rest.splitlines()[1:] if line[:1] > ' '), '')
                return f'a traceback of {log.stem}: {error}'
        return ''


def odometry_result(share: float, least: float) -> CaseResult:
    """Return the result for a share of images with odometry; it fails below `least`."""
    complaint = '' if share >= least else f'odometry for {share:.2f} of the images'
    return CaseResult(complaint, f'odometry {share:.2f}')


def member_pids(pids: Mapping[str, int]) -> dict[str, int]:
    """Return the process ids of the nodes, and of the mapper once it has started, by name."""
    workers = [
        worker for server in psutil.Process(pids[SLAM]).children() for worker in server.children()
    ]
    return {**pids, MAPPER: workers[0].pid} if workers else dict(pids)


@contextmanager
def running_nodes(folder: Path, setup: Setup) -> Iterator[NodeHarness]:
    """Run the nodes, and yield them when all their outputs have been received.

    Raises:
        HoidError: An output or a response is missing after 60 s.
    """
    maps = folder / MAPS
    maps.mkdir(parents=True)
    specs = [
        replace(spec, env=setup.environment)
        for options in setup.options(maps)
        for spec in node_specs(options)
    ]
    with (
        own_domain(),
        watched(specs, restart=setup.restart, log_dir=folder) as nodes,
        camera(setup) as sender,
    ):
        if silent := sender.missing_outputs(START_S, setup.outputs):
            raise HoidError(f'no {", ".join(silent)} within {START_S:g} s of good messages')
        for _ in range(_WARM_IMAGES):
            sender.send()
        harness = NodeHarness(setup, folder, nodes, sender)
        # The memory of first responses must not count as growth in the first case.
        if unanswered := harness.services.unanswered(START_S):
            raise HoidError(f'no response from {", ".join(unanswered)} within {START_S:g} s')
        yield harness


@contextmanager
def camera(setup: Setup) -> Iterator[Sender]:
    """Yield a simulated camera, whose ROS node ends with the block."""
    rclpy.init()
    use_sim_time = Parameter('use_sim_time', value=False)
    node = rclpy.create_node('faults', parameter_overrides=[use_sim_time])
    try:
        yield Sender(
            node, setup.scene or Scene(), setup.rate_hz,
            is_compressed=setup.is_compressed, is_foreign=setup.is_foreign,
        )  # fmt: skip
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
