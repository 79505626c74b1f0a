"""Base class of the suite's lifecycle nodes, which can activate themselves."""

from __future__ import annotations

import logging
from collections.abc import Callable

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node

from hoid_common.errors import ConfigError, HoidError
from hoid_common.process.shared_memory import restrict_segments, shared_memory_problem
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.parameters import AcceptsEmptyLists

_PROBLEM, _SHARED_MEMORY = 'configuring', 'shared memory'


class ManagedNode(AcceptsEmptyLists, LifecycleNode):
    """Base class of the suite's lifecycle nodes, which process messages only while active.

    This holds for the subscriptions of `Inputs`; transforms and services are always processed. A
    subclass loads its models and files in `configure` and drops its state in `clean_up`. There is
    no bond with a lifecycle manager: set Nav2's `bond_timeout` to 0.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        restrict_segments()
        bridge_logging(self)
        self.diagnostics = Diagnostics(self)
        if problem := shared_memory_problem():
            self.diagnostics.set_problem(_SHARED_MEMORY, problem, severe=True)
        self.is_active = False
        self._autostart = True
        self._failure: HoidError | None = None
        self.on_activation: list[Callable[[], None]] = []  # called when the node becomes active

    def configure(self) -> None:
        """Load the models and files of the node; HoidError if that fails."""

    def clean_up(self) -> None:
        """Reset the node to its state before `configure`."""

    def pause(self) -> None:
        """Drop all waiting messages."""

    def begin(self, *, autostart: bool) -> None:
        """Configure and activate the node, or wait for a lifecycle manager; call this last.

        HoidError if `configure` fails with autostart; the node is then destroyed.
        """
        self._autostart = autostart
        if not autostart:
            self.get_logger().info('waiting for a lifecycle manager (autostart is off)')
            return
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS:
                try:
                    raise self._failure or ConfigError(f'{self.get_name()} stays inactive')
                finally:
                    self.destroy_node()  # a subclass may have started threads and processes

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        try:
            self.configure()
        except HoidError as error:
            self._failure = error
            if not self._autostart:  # otherwise the process ends and prints the error
                self.diagnostics.set_problem(_PROBLEM, str(error), severe=True)
            return TransitionCallbackReturn.FAILURE
        self.diagnostics.clear_problem(_PROBLEM)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        self.is_active = True
        self.get_logger().info(f'active, waiting for {self.diagnostics.awaited}')
        for function in self.on_activation:
            function()
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        self.is_active = False
        self.pause()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        self.clean_up()
        return TransitionCallbackReturn.SUCCESS

    on_shutdown = on_deactivate


class _NodeHandler(logging.Handler):
    def __init__(self, node: Node) -> None:
        super().__init__()
        self._logger = node.get_logger()

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        # rclpy raises an error if the same line of code logs with different severities, hence one
        # line for each severity.
        if record.levelno >= logging.CRITICAL:
            self._logger.fatal(text)
        elif record.levelno >= logging.ERROR:
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        elif record.levelno >= logging.INFO:
            self._logger.info(text)
        else:
            self._logger.debug(text)


def bridge_logging(node: Node) -> None:
    """Forward Python's log records to a node's logger, and no longer to that of another node."""
    root = logging.getLogger()
    for handler in [h for h in root.handlers if isinstance(h, _NodeHandler)]:
        root.removeHandler(handler)
    root.addHandler(_NodeHandler(node))
    # rclpy's severities have the same numbers as `logging`'s levels.
    root.setLevel(int(node.get_logger().get_effective_level()))
