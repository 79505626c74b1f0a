"""Log lines about the inputs of a node: missing, losing messages, and arriving again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

from hoid_common.inputs.input_watch import InputWatch
from hoid_common.log_throttle import Backoff

_PERIOD_S = 5.0  # chosen: shortest time between two log lines about the same problem
_MAX_PERIOD_S = 300.0  # chosen: longest time between two log lines about a lasting problem
_GRACE_S = 5.0  # chosen: the nodes of a launch start within this time, and then know each other


class Logger(Protocol):
    """Logger of a node or of Python."""

    def info(self, text: str, /) -> object: ...

    def warning(self, text: str, /) -> object: ...


class InputLog:
    """Logs the problems of a node's inputs with exponential back-off, and inputs that arrive.

    `is_cause` returns whether a topic is to be logged when its messages are missing or arrive: a
    node that waits for another one leaves that to it. Missing inputs are not logged in the five
    seconds after `start_s`.
    """

    def __init__(self, logger: Logger, is_cause: Callable[[str], bool], start_s: float) -> None:
        self._logger, self._is_cause, self._start_s = logger, is_cause, start_s
        self._backoff = Backoff(_PERIOD_S, _MAX_PERIOD_S)
        self._arriving: set[str] = set()  # topics logged as arriving

    def update(
        self,
        now_s: float,
        watches: Sequence[InputWatch],
        missing: Mapping[str, str],
        others: Mapping[str, str],
    ) -> None:
        """Log the problems that are due (`missing` by topic), and inputs that arrive."""
        causes = {topic: text for topic, text in missing.items() if self._is_cause(topic)}
        if now_s < self._start_s + _GRACE_S:
            causes = {}
        due = self._backoff.due([*causes, *others], now_s)
        lines = [others[kind] for kind in due if kind in others]
        if not causes.keys().isdisjoint(due):
            lines.insert(0, '; '.join(causes.values()))
            self._arriving -= causes.keys()
        for line in lines:
            self._logger.warning(line)
        self._log_arriving([w for w in watches if w.num_received and w.topic not in missing])

    def _log_arriving(self, watches: Sequence[InputWatch]) -> None:
        new = [w for w in watches if not w.is_occasional and w.topic not in self._arriving]
        self._arriving |= {watch.topic for watch in new}
        texts = [f'{w.what} on {w.topic}' for w in new if self._is_cause(w.topic)]
        if texts:
            self._logger.info(f'receiving {", ".join(texts)}')
