"""Say in plain words which input is missing, and why it may be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hoid_common.inputs.input_config import BEST_EFFORT

_TIMEOUT_S = 2.0
_LOSS_S = 5.0  # after which losses are over


@dataclass
class InputWatch:
    """When an input was last heard."""

    what: str  # such as "depth images"
    topic: str
    reliability: str  # what we ask for: "best_effort" or "reliable"
    since_s: float  # steady time of the subscription
    is_occasional: bool = False  # silence is nothing to complain of
    last_s: float | None = None  # steady time of the newest message
    num_received: int = 0
    num_lost: int = 0  # sent, but not received whole
    _losing_since_s: float = -_LOSS_S
    _losing_s: float = -_LOSS_S  # until when
    _num_losing: int = 0

    def heard(self, now_s: float) -> None:
        """Note a message."""
        self.last_s = now_s
        self.num_received += 1

    def lost(self, now_s: float, number: int) -> None:
        """Note messages that will not come any more."""
        if not self.is_losing(now_s):
            self._losing_since_s, self._num_losing = now_s, 0
        self._losing_s = now_s
        self._num_losing += number
        self.num_lost += number

    def is_losing(self, now_s: float) -> bool:
        """Return whether some got lost lately."""
        return now_s - self._losing_s < _LOSS_S and self.num_lost > 0

    def loss(self, now_s: float) -> str:
        """Return one line on what gets lost."""
        return (
            f'{self.what} on {self.topic} get lost on their way for '
            f'{now_s - self._losing_since_s:.1f} s: {self._num_losing} so far; the network or a '
            'busy machine loses them'
        )

    def is_missing(self, now_s: float) -> bool:
        """Return whether it has been silent for too long."""
        return not self.is_occasional and self._silent_s(now_s) > _TIMEOUT_S

    def complaint(self, now_s: float, offered: Sequence[str]) -> str:
        """Return one line on the missing input.

        Args:
            offered: the reliability that each publisher of the topic offers.
        """
        yet = ' yet' if self.last_s is None else ''
        head = f'no {self.what}{yet} for {self._silent_s(now_s):.1f} s on {self.topic}'
        if not offered:
            return f'{head}: no publisher'
        found = f'{head}: {len(offered)} publisher{"s" if len(offered) > 1 else ""}'
        if self.reliability == BEST_EFFORT or BEST_EFFORT not in offered:
            return f'{found}, silent'
        kinds = ', '.join(sorted(set(offered)))
        return f'{found}, reliability {kinds}, we ask for {self.reliability}'

    def _silent_s(self, now_s: float) -> float:
        return now_s - (self.since_s if self.last_s is None else self.last_s)
