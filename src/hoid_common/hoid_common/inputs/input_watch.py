"""Detection of missing and lost input messages, with log lines that name the probable reason."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from hoid_common.inputs.input_config import BEST_EFFORT
from hoid_common.log_throttle import Backoff
from hoid_common.process.shared_memory import PROFILE_VARIABLE

_TIMEOUT_S = 2.0  # chosen: silence after which an input counts as missing; 60 images at 30 Hz
_MIN_SERIES_S = 1.0  # chosen: losses that go on for less time are counted, but not reported
_LOSS_S = 5.0  # chosen: a series of losses has ended after this time without a loss
_PERIOD_S = 5.0  # chosen: shortest time between two log lines about the same problem
_MAX_PERIOD_S = 300.0  # chosen: longest time between two log lines about a lasting problem
# Chosen: no missing input is logged for so long, because all nodes of a launch start within it.
_GRACE_S = 5.0


@dataclass
class InputWatch:
    """Statistics of a subscription: received and lost messages, time of the newest one."""

    what: str  # the messages in the plural, such as "depth images"
    topic: str  # full name
    reliability: str  # what the subscription requests: "best_effort" or "reliable"
    since_s: float  # time of the subscription
    is_occasional: bool = False  # whether it is normal that no message arrives for long
    is_latched: bool = False  # whether silence is normal after the first message
    last_s: float | None = None  # time of the newest message
    num_received: int = 0
    num_lost: int = 0  # messages that were sent, but did not arrive complete
    # Losses form one series while less than five seconds lie between two of them.
    _losing_since_s: float = -_LOSS_S  # time of the first loss in the current series
    _losing_s: float = -_LOSS_S  # time of the last loss in the current series
    _num_losing: int = 0  # messages lost in the current series
    _received_before: int = 0  # messages received before the current series
    _losing_reliability: str = ''  # what the subscription requested at the last loss

    def record_message(self, now_s: float) -> None:
        self.last_s = now_s
        self.num_received += 1

    def record_loss(self, now_s: float, number: int) -> None:
        if not self._is_in_series(now_s):
            self._losing_since_s, self._num_losing = now_s, 0
            self._received_before = self.num_received
        self._losing_s, self._losing_reliability = now_s, self.reliability
        self._num_losing += number
        self.num_lost += number

    def is_losing(self, now_s: float) -> bool:
        """Return whether a series of losses has lasted a second, the last within five seconds."""
        return self._is_in_series(now_s) and self._losing_s - self._losing_since_s >= _MIN_SERIES_S

    def _is_in_series(self, now_s: float) -> bool:
        return now_s - self._losing_s < _LOSS_S and self.num_lost > 0

    def loss_message(self, now_s: float, profile: str = '', *, is_own: bool = False) -> str:
        """Return a log line with the number of messages lost at present, and a remedy.

        If publishers are best effort, the remedy is the Fast DDS `profile`, except for topics of
        the suite itself (`is_own`), whose nodes already use it.
        """
        arrived = self.num_received - self._received_before
        remedy = 'check the network and the processor load'
        if is_own:
            remedy = 'reduce the load of the computer'
        elif self._losing_reliability == BEST_EFFORT:
            setting = f'{PROFILE_VARIABLE}={profile} or ' if profile else ''
            remedy = f'start their publisher with {setting}reliable QoS, or {remedy}'
        return (
            f'{arrived} of {arrived + self._num_losing} {self.what} on {self.topic} have arrived '
            f'in {now_s - self._losing_since_s:.1f} s: {remedy}'
        )

    def is_missing(self, now_s: float) -> bool:
        """Return whether a message was due, but none has come for two seconds."""
        is_enough = self.is_occasional or (self.is_latched and self.num_received > 0)
        return not is_enough and self._silent_s(now_s) > _TIMEOUT_S

    def missing_message(self, now_s: float, offered: Sequence[str]) -> str:
        """Return a log line with a probable reason; `offered` is each publisher's reliability."""
        yet = ' yet' if self.last_s is None else ''
        head = f'no {self.what}{yet} for {self._silent_s(now_s):.1f} s on {self.topic}'
        if not offered:
            return f'{head}: no publisher'
        found = f'{head}: {len(offered)} publisher{"s" if len(offered) > 1 else ""}'
        if self.reliability == BEST_EFFORT or BEST_EFFORT not in offered:
            return f'{found}, silent'
        kinds = ', '.join(sorted(set(offered)))
        return f'{found}, reliability {kinds}, but the subscription requests {self.reliability}'

    def _silent_s(self, now_s: float) -> float:
        return now_s - (self.since_s if self.last_s is None else self.last_s)


class Logger(Protocol):
    """The methods that a node's logger and a Python logger have in common."""

    def info(self, text: str, /) -> object: ...

    def warning(self, text: str, /) -> object: ...


class InputLog:
    """Logs a node's missing inputs and other problems with exponential back-off, and their end.

    `is_cause(topic)` returns whether this node logs that the messages of the topic are missing or
    arrive again. If not, another node does, such as a publisher of the topic that lacks an input
    itself. Missing inputs are not logged in the five seconds after `start_s`.
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
        """Log due problems (`missing` by topic, `others` by kind), and inputs that arrive."""
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
