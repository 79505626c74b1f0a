"""Which frame waits for which answer when a bag is played in lockstep."""

from __future__ import annotations

from hoid_bags.bag.bag_sequence import BagSequence, header_stamp_ns
from hoid_bags.live.playback import ScheduledMessage


class LockstepGate:
    """Lets a color image pass once the frame before it, colour and depth, has been answered.

    Images without a partner make no frame, so nothing waits for them.
    """

    def __init__(self, sequence: BagSequence) -> None:
        self._color, self._depth = sequence.topics.color.name, sequence.topics.depth.name
        self._depth_of_color = sequence.depth_of_color
        self._pending_ns: int | None = None  # colour stamp of the frame that is out
        self._pending_depth_ns = 0
        self._last_depth_ns = -1
        self.num_answered = 0
        self.num_unanswered = 0

    def blocks(self, cue: ScheduledMessage) -> bool:
        """Return whether a cue has to wait for an answer."""
        is_out = self._pending_ns is not None and self._last_depth_ns >= self._pending_depth_ns
        return is_out and self._partner_ns(cue) is not None

    def note_published(self, cue: ScheduledMessage) -> None:
        """Take note of what has gone out."""
        partner_ns = self._partner_ns(cue)
        if partner_ns is not None:
            self._pending_ns, self._pending_depth_ns = header_stamp_ns(cue.data), partner_ns
        elif cue.topic == self._depth:
            self._last_depth_ns = header_stamp_ns(cue.data)

    def note_answer(self, stamp_ns: int) -> None:
        """Take note of odometry or status for the image of a stamp."""
        if self._pending_ns is not None and stamp_ns >= self._pending_ns:
            self._pending_ns = None
            self.num_answered += 1

    def give_up(self) -> None:
        """Let the next frame pass without an answer."""
        self._pending_ns = None
        self.num_unanswered += 1

    def _partner_ns(self, cue: ScheduledMessage) -> int | None:
        """Return the depth stamp of a color image that has a partner."""
        if cue.topic != self._color:
            return None
        depth_ns = self._depth_of_color.get(header_stamp_ns(cue.data) - cue.offset_ns)
        return None if depth_ns is None else depth_ns + cue.offset_ns
