"""Log lines about the inputs of a node: missing, losing messages, and arriving again.

The nodes of the suite wait for each other, so that one missing camera would be logged by all of
them. Of the nodes that subscribe to a camera, only the filter logs that it is missing; and a node
that waits for a silent node of the suite logs nothing, since that one logs its own reason.
/diagnostics shows everything.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from rclpy.node import Node

from hoid_common.inputs.input_watch import InputWatch
from hoid_common.log_throttle import Backoff

_PERIOD_S = 5.0  # chosen: shortest time between two log lines about the same problem
_MAX_PERIOD_S = 300.0  # chosen: longest time between two log lines about a lasting problem
_FILTER = 'hoid_filter'
_SUITE = ('hoid_detector', _FILTER, 'rgbd_slam')  # names of nodes, which a remap may change


class InputLog:
    """Logs the problems of a node's inputs with exponential back-off, and their end once."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._backoff = Backoff(_PERIOD_S, _MAX_PERIOD_S)
        self._arriving: set[str] = set()  # topics logged as arriving

    def update(
        self, watches: Sequence[InputWatch], missing: Mapping[str, str], others: Mapping[str, str]
    ) -> None:
        """Log what has changed; called once a second.

        Args:
            watches: All inputs.
            missing: Text by topic of each missing input; all of them are logged in one line.
            others: Text of each other problem by its kind.
        """
        causes = {topic: text for topic, text in missing.items() if self._is_cause(topic)}
        due = self._backoff.due([*causes, *others], time.monotonic())
        lines = [others[kind] for kind in due if kind in others]
        if not causes.keys().isdisjoint(due):
            lines.insert(0, '; '.join(causes.values()))
            self._arriving -= causes.keys()
        for line in lines:
            self._node.get_logger().warning(line)
        self._log_arriving([w for w in watches if w.num_received and w.topic not in missing])

    def _log_arriving(self, watches: Sequence[InputWatch]) -> None:
        """Log the inputs that arrive for the first time, or again after they were missing."""
        new = [w for w in watches if not w.is_occasional and w.topic not in self._arriving]
        self._arriving |= {watch.topic for watch in new}
        texts = [f'{w.what} on {w.topic}' for w in new if self._is_cause(w.topic)]
        if texts:
            self._node.get_logger().info(f'receiving {", ".join(texts)}')

    def _is_cause(self, topic: str) -> bool:
        """Return whether no other node of the suite logs why the messages are missing."""
        publishers = self._node.get_publishers_info_by_topic(topic)
        if publishers and all(info.node_name in _SUITE for info in publishers):
            return False
        subscribers = self._node.get_subscriptions_info_by_topic(topic)
        is_filter = self._node.get_name() == _FILTER
        return is_filter or all(info.node_name != _FILTER for info in subscribers)
