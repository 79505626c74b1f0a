"""Whether objects still have their number later, and when they are seen again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hoid_benchmarks.rooms.object_truth import TrueObject
from hoid_benchmarks.rooms.room_run import MappedRoom
from hoid_benchmarks.rooms.visits.change_scores import assigned

# An object is seen again if it is known after the first of these shares of the time, and was seen
# after the second one. On the path "loop", the camera looks at other rooms meanwhile.
_KNOWN_SHARE, _AGAIN_SHARE = 0.5, 0.8


class NumberScores(NamedTuple):
    """Counts of one or more rooms."""

    num_loops: int
    num_known: int  # objects that nobody carried, and that the map has early and at the end
    num_same: int  # of these, with the same number at the end
    num_again: int  # of the known ones, those that were seen late
    num_same_again: int  # of these, with the same number at the end


def score_numbers(room: MappedRoom, true: Sequence[TrueObject]) -> NumberScores:
    """Return how many of the objects that nobody carried keep their number."""
    num_loops, stamps = room.stats.num_loops, sorted(room.history)
    if not stamps:
        return NumberScores(num_loops, 0, 0, 0, 0)
    resting = {item.instance: item for item in true if not item.was_carried}
    known_ns, again_ns = (
        stamps[0] + round(share * (stamps[-1] - stamps[0]))
        for share in (_KNOWN_SHARE, _AGAIN_SHARE)
    )
    early = room.history[max(stamp_ns for stamp_ns in stamps if stamp_ns <= known_ns)]
    before, after = assigned(early, resting), assigned(room.objects, resting)
    known = before.keys() & after.keys()
    same = {k for k in known if before[k].object_id == after[k].object_id}
    again = {k for k in known if after[k].last_ns >= again_ns}
    return NumberScores(num_loops, len(known), len(same), len(again), len(same & again))
