"""Lockstep: each frame waits until the odometry of the previous frame has been published."""

from __future__ import annotations

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.bag.stamps import header_stamp_ns
from hoid_bags.live.playback import ScheduledMessage


class LockstepGate:
    """Holds a color image back until odometry for the previous pair of images has arrived.

    A color image that has no depth image is not held back, and no image waits for the odometry of
    such an image.
    """

    def __init__(self, sequence: BagSequence) -> None:
        self._color, self._depth = sequence.topics.color.name, sequence.topics.depth.name
        self._depth_of_color = sequence.depth_of_color
        self._pending_ns: int | None = None  # color stamp of the frame without odometry yet
        self._pending_depth_ns = 0
        self._last_depth_ns = -1
        self.num_answered = 0
        self.num_unanswered = 0

    def blocks(self, message: ScheduledMessage) -> bool:
        """Return whether a message is a color image that must wait for the previous odometry."""
        is_out = self._pending_ns is not None and self._last_depth_ns >= self._pending_depth_ns
        return is_out and self._partner_ns(message) is not None

    def note_published(self, message: ScheduledMessage) -> None:
        partner_ns = self._partner_ns(message)
        if partner_ns is not None:
            self._pending_ns, self._pending_depth_ns = header_stamp_ns(message.data), partner_ns
        elif message.topic == self._depth:
            self._last_depth_ns = header_stamp_ns(message.data)

    def note_answer(self, stamp_ns: int) -> None:
        """Record that odometry or status for an image of this stamp (ns), or later, has come."""
        if self._pending_ns is not None and stamp_ns >= self._pending_ns:
            self._pending_ns = None
            self.num_answered += 1

    def give_up(self) -> None:
        self._pending_ns = None
        self.num_unanswered += 1

    def _partner_ns(self, message: ScheduledMessage) -> int | None:
        """Return the published stamp (ns) of the depth image of a color image; None: no pair."""
        if message.topic != self._color:
            return None
        depth_ns = self._depth_of_color.get(header_stamp_ns(message.data) - message.offset_ns)
        return None if depth_ns is None else depth_ns + message.offset_ns
