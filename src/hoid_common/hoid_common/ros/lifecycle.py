"""Nodes that a lifecycle manager can drive, and that otherwise become active by themselves."""

from __future__ import annotations

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from hoid_common.errors import ConfigError, HoidError
from hoid_common.process.shared_memory import missing_shared_memory
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.logs import bridge_logging

_PROBLEM, _SHARED_MEMORY = 'configuring', 'shared memory'


class ManagedNode(LifecycleNode):
    """A node of the suite: `Inputs` take messages only while it is active.

    What it publishes and subscribes to is made once; a subclass gets ready in `configure` and
    forgets in `clean_up`. There is no bond: of Nav2's manager, `bond_timeout` is to be 0.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        bridge_logging(self)
        self.diagnostics = Diagnostics(self)
        if problem := missing_shared_memory():
            self.diagnostics.set_problem(_SHARED_MEMORY, problem, severe=True)
        self.is_active = False
        self._autostart = True
        self._failure: HoidError | None = None

    def configure(self) -> None:
        """Get ready to take messages; raises HoidError when that cannot be."""

    def clean_up(self) -> None:
        """Forget what came, as if the node were new."""

    def pause(self) -> None:
        """Drop what waits, as no more messages are taken."""

    def begin(self, *, autostart: bool) -> None:
        """Become active, or wait for a manager; to be called when all is made.

        Raises:
            HoidError: `configure` raised it, and the node is destroyed. A manager is told by a
                failed transition instead.
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
                    self.destroy_node()  # it has threads and processes already

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Get ready."""
        try:
            self.configure()
        except HoidError as error:
            self._failure = error
            if not self._autostart:  # else the process ends with it
                self.diagnostics.set_problem(_PROBLEM, str(error), severe=True)
            return TransitionCallbackReturn.FAILURE
        self.diagnostics.clear_problem(_PROBLEM)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Take messages."""
        self.is_active = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Take no more messages."""
        self.is_active = False
        self.pause()
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Forget what came."""
        self.clean_up()
        return TransitionCallbackReturn.SUCCESS

    on_shutdown = on_deactivate
