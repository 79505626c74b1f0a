"""The history of an object over days: when it was found, carried, put down, gone, or back."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import NamedTuple

from hoid_common.values import NS_PER_S, ObjectState

# Chosen: an object that is seen again after so long out of view gets an event.
_AWAY_NS = 600 * NS_PER_S
MAX_EVENTS = 100  # chosen: 16 kB; beyond it, the first and the newest events are kept


class EventKind(Enum):
    """What has happened to an object; hoid_msgs/ObjectEvent has the same values."""

    NEW = 1  # it was found for the first time
    SEEN = 2  # it was seen at its place after at least 10 minutes, or after it had been away
    CARRIED = 3  # a person took it
    PUT_DOWN = 4  # it was found at another place
    GONE = 5  # its place was seen empty


class ObjectEvent(NamedTuple):
    """One event in the history of an object."""

    stamp_ns: int  # stamp of the image that showed it
    kind: EventKind
    # Track of the person who took it or put it down, in the session of the stamp; -1: unknown.
    person_id: int = -1
    distance_m: float = 0.0  # for PUT_DOWN: distance from the previous place


class PresentState(NamedTuple):
    """The state of an object after an image, from which its history follows."""

    state: ObjectState
    first_ns: int  # stamp of the first sighting
    last_ns: int  # stamp of the last sighting
    left_ns: int  # stamp of the image that showed that it is not at its place
    moved_ns: int  # stamp of the last sighting at the previous place; 0: not moved
    moved_m: float  # distance from the previous place
    person_id: int


class History:
    """The events of one object, ordered by time, at most `MAX_EVENTS`.

    Attributes:
        seen_ns: Stamp of the last sighting that was considered.
        moved_ns: `PresentState.moved_ns` of the last move that was considered.
    """

    def __init__(self) -> None:
        self.events: tuple[ObjectEvent, ...] = ()
        self.seen_ns = self.moved_ns = 0

    def continue_from(self, seen_ns: int, moved_ns: int) -> None:
        """Set the stamps of the last sighting and the last move that the events contain."""
        self.seen_ns, self.moved_ns = seen_ns, moved_ns

    def note(self, now: PresentState, stamp_ns: int) -> bool:
        """Add the events that the state after an image shows; return whether there are any.

        A tentative object has none.
        """
        found = [] if now.state is ObjectState.TENTATIVE else list(self._found(now, stamp_ns))
        if found:
            self.add(found)
        self.seen_ns = now.last_ns
        return bool(found)

    def _found(self, now: PresentState, stamp_ns: int) -> Iterable[ObjectEvent]:
        last = self.events[-1].kind if self.events else EventKind.NEW
        if not self.events:
            yield ObjectEvent(now.first_ns, EventKind.NEW)
        if now.moved_ns != self.moved_ns:
            self.moved_ns = now.moved_ns
            yield ObjectEvent(stamp_ns, EventKind.PUT_DOWN, now.person_id, now.moved_m)
        elif now.state is ObjectState.HANDLED and last is not EventKind.CARRIED:
            yield ObjectEvent(now.left_ns, EventKind.CARRIED, now.person_id)
        elif now.state is ObjectState.GONE and last is not EventKind.GONE:
            yield ObjectEvent(now.left_ns, EventKind.GONE)
        elif now.state.is_at_rest:
            was_away = last in (EventKind.CARRIED, EventKind.GONE)
            if was_away or now.last_ns - self.seen_ns >= _AWAY_NS:
                yield ObjectEvent(now.last_ns, EventKind.SEEN)

    def add(self, events: Iterable[ObjectEvent]) -> None:
        """Add events, including events of another object that proved to be the same object.

        Only the first event remains NEW: at later events the object was known already.
        """
        known = sorted(
            {*self.events, *events}, key=lambda event: (event.stamp_ns, event.kind.value)
        )
        later = [event for event in known[1:] if event.kind is not EventKind.NEW]
        self.events = (*known[:1], *later[-(MAX_EVENTS - 1) :])
