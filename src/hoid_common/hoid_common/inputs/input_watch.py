"""Detection of missing and lost input messages, with texts that name the probable reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hoid_common.inputs.input_config import BEST_EFFORT

_TIMEOUT_S = 2.0  # chosen: silence after which an input counts as missing; 60 images at 30 Hz
_LOSS_S = 5.0  # chosen: time without a loss after which losses count as over


@dataclass
class InputWatch:
    """Reception of one input: the time of the newest message, and counts. Times are steady."""

    what: str  # the messages in the plural, such as "depth images"
    topic: str  # full name
    reliability: str  # what the subscription requests: "best_effort" or "reliable"
    since_s: float  # time of the subscription
    is_occasional: bool = False  # whether silence is normal
    last_s: float | None = None  # time of the newest message
    num_received: int = 0
    num_lost: int = 0  # messages that were sent, but did not arrive complete
    _losing_since_s: float = -_LOSS_S  # first loss of the current series
    _losing_s: float = -_LOSS_S  # last loss of the current series
    _num_losing: int = 0  # losses in the current series

    def record_message(self, now_s: float) -> None:
        """Count a received message."""
        self.last_s = now_s
        self.num_received += 1

    def record_loss(self, now_s: float, number: int) -> None:
        """Count messages that the middleware reports as lost."""
        if not self.is_losing(now_s):
            self._losing_since_s, self._num_losing = now_s, 0
        self._losing_s = now_s
        self._num_losing += number
        self.num_lost += number

    def is_losing(self, now_s: float) -> bool:
        """Return whether messages were lost in the last five seconds."""
        return now_s - self._losing_s < _LOSS_S and self.num_lost > 0

    def loss_message(self, now_s: float) -> str:
        """Return one line of text about the current losses."""
        return (
            f'{self.what} on {self.topic} have been getting lost for '
            f'{now_s - self._losing_since_s:.1f} s: {self._num_losing} so far; check the network '
            'and the processor load'
        )

    def is_missing(self, now_s: float) -> bool:
        """Return whether the input has been silent for too long."""
        return not self.is_occasional and self._silent_s(now_s) > _TIMEOUT_S

    def missing_message(self, now_s: float, offered: Sequence[str]) -> str:
        """Return one line of text about the missing input.

        Args:
            now_s: Steady time.
            offered: Reliability that each publisher of the topic offers.
        """
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
