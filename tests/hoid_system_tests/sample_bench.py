"""A small node with parameters and image inputs, and a probe that talks to it."""

from __future__ import annotations

from dataclasses import dataclass, field

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from hoid_common.config import Config, param
from hoid_common.errors import MessageError
from hoid_common.inputs.input_config import InputConfig
from hoid_common.ros import conversions
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.inputs import Inputs, Synchronizer
from hoid_common.ros.parameters import AcceptsEmptyLists, Parameters
from hoid_common.sync import Match, StampMatcher
from hoid_system_tests.probe import Probe

_SLOP_NS = 20_000_000


@dataclass(frozen=True)
class Rule(Config):
    """Parameters of a nested section."""

    share: float = param(0.5, 'a share', limits=(0.0, 1.0), read_only=False)
    classes: tuple[str, ...] = param((), 'classes', read_only=False)


@dataclass(frozen=True)
class Settings(Config):
    """Parameters of the sample node."""

    number: int = param(3, 'a number', limits=(1, 9))
    mode: str = param('fast', 'a mode', choices=('fast', 'slow'), read_only=False)
    rule: Rule = field(default_factory=Rule)
    input: InputConfig = field(default_factory=InputConfig)


class SampleNode(AcceptsEmptyLists):
    """Matches color and depth images, and refuses those that differ in size."""

    def __init__(self, context: Context, *args: str) -> None:
        super().__init__(
            'sample',
            context=context,
            cli_args=['--ros-args', *args],
            automatically_declare_parameters_from_overrides=True,
        )
        self.changes: list[Settings] = []
        self.matches: list[Match] = []
        self.parameters = Parameters(self, Settings(), self.changes.append)
        self.diagnostics = Diagnostics(self)
        inputs = Inputs(self, self.parameters.config.input, self.diagnostics)
        matcher = StampMatcher(('color', 'depth'), _SLOP_NS)
        self.sync = Synchronizer(matcher, self._on_match, self.diagnostics)
        inputs.color(self.sync.input('color', conversions.color_from_msg))
        inputs.depth(self.sync.input('depth', conversions.depth_from_msg))

    def _on_match(self, match: Match) -> None:
        sizes = [value.shape[:2] for _, value in match.values]
        if sizes[0] != sizes[1]:
            raise MessageError(f'sizes {sizes} differ')
        self.matches.append(match)


class SampleBench:
    """The sample node and a probe, spun in one thread."""

    def __init__(self, domain_id: int, *args: str) -> None:
        self.probe = Probe(domain_id)
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain_id)
        self.node = SampleNode(self._context, *args)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        # Whenever the probe spins, it spins the node as well.
        self.probe.node.create_timer(0.002, lambda: self._executor.spin_once(timeout_sec=0.0))

    def close(self) -> None:
        """Destroy the node and the probe."""
        self.probe.close()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def status(self) -> DiagnosticStatus:
        """Return the present diagnostics of the node."""
        return self.node.diagnostics.status()

    def count(self, name: str) -> int:
        """Return a counter of the diagnostics, 0 before its first event."""
        values = {pair.key: pair.value for pair in self.status().values}
        return int(values.get(name, '0'))
