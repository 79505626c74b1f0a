"""Comparison of what an object map says of a rearranged room with the true changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from hoid_benchmarks.rooms.object_scores import FoundObject, rating, score_objects
from hoid_benchmarks.rooms.object_truth import TrueObject
from hoid_benchmarks.rooms.placed_box import PlacedBox
from hoid_benchmarks.rooms.visits.true_changes import ChangeKind, TrueChange, TrueVisits
from hoid_common.values import ObjectState
from hoid_scene.objects.mapped_object import MapObject


class Claim(NamedTuple):
    """A change as the map reports it: an object at its saved place, and at its present one."""

    kind: ChangeKind
    before: MapObject | None  # None: it is new
    after: MapObject | None  # None: it is gone


class ChangeScores(NamedTuple):
    """How many true and claimed changes there are in one or more rooms, and how many are right.

    A claim about an object that the visits did not show for long enough is not counted.
    """

    num_expected: int  # changes that the visits showed long enough
    num_found: int  # of these, with the right kind and at the right places
    num_claims: int
    num_wrong: int  # claims that are no true change of this kind
    # The same with moved objects as two changes: one is gone from a place, one is new at another.
    num_expected_places: int
    num_found_places: int
    num_place_claims: int
    num_wrong_places: int
    num_known: int  # unchanged objects that the map has after both visits
    num_same: int  # of these, with the same number
    num_double: int  # objects of the map after the second visit that it has more than once

    @property
    def f1(self) -> float:
        """Return the harmonic mean of recall and precision of the changes by kind."""
        return _f1(self.num_expected, self.num_found, self.num_claims, self.num_wrong)

    @property
    def place_f1(self) -> float:
        """Return the same of the places that an object left, or came to."""
        return _f1(
            self.num_expected_places,
            self.num_found_places,
            self.num_place_claims,
            self.num_wrong_places,
        )


def _f1(num_expected: int, num_found: int, num_claims: int, num_wrong: int) -> float:
    recall = num_found / max(num_expected, 1)
    precision = 1 - num_wrong / max(num_claims, 1)
    return 2 * recall * precision / max(recall + precision, 1e-9)


def claimed_changes(saved: Sequence[MapObject], now: Sequence[MapObject]) -> list[Claim]:
    """Return the changes that a map reports since it was saved."""
    before = {item.object_id: item for item in saved}
    out = []
    for item in now:
        old = before.get(item.object_id)
        if old is None:
            if item.is_new and item.is_present:
                out.append(Claim(ChangeKind.NEW, None, item))
        elif old.is_present and not item.is_present:
            out.append(Claim(ChangeKind.GONE, old, None))
        elif item.state is ObjectState.MOVED and item.moved_ns != old.moved_ns:
            out.append(Claim(ChangeKind.MOVED, old, item))
    return out


def score_changes(
    saved: Sequence[MapObject], now: Sequence[MapObject], visits: TrueVisits
) -> ChangeScores:
    """Return the scores of a map.

    Args:
        saved: Its objects at the end of the first visit.
        now: Its objects at the end of the second visit.
        visits: The true objects.
    """
    claims = claimed_changes(saved, now)
    by_kind = _counts(claims, visits.changes, visits)
    by_place = _counts(
        [part for claim in claims for part in _places(claim)],
        [part for change in visits.changes for part in _true_places(change)],
        visits,
    )
    num_known, num_same = _numbers(saved, now, visits)
    found = [_found(item) for item in now if item.is_present]
    num_double = score_objects(found, list(visits.second.values())).num_double
    return ChangeScores(*by_kind, *by_place, num_known, num_same, num_double)


def _places(claim: Claim) -> list[Claim]:
    if claim.kind is not ChangeKind.MOVED:
        return [claim]
    return [
        Claim(ChangeKind.GONE, claim.before, None),
        Claim(ChangeKind.NEW, None, claim.after),
    ]


def _true_places(change: TrueChange) -> list[TrueChange]:
    if change.kind is not ChangeKind.MOVED:
        return [change]
    return [
        change._replace(kind=ChangeKind.GONE, after=None),
        change._replace(kind=ChangeKind.NEW, before=None),
    ]


def _counts(
    claims: Sequence[Claim], changes: Sequence[TrueChange], visits: TrueVisits
) -> tuple[int, int, int, int]:
    """Return the numbers of expected and of found changes, of claims, and of wrong claims."""
    left = list(changes)
    num_found = num_claims = num_wrong = 0
    for claim in claims:
        right = next((change for change in left if _is_right(claim, change)), None)
        if right is not None:
            left.remove(right)
            num_found += right.is_expected
            num_claims += right.is_expected
        elif not _is_unknowable(claim, visits):
            num_claims += 1
            num_wrong += 1
    return sum(change.is_expected for change in changes), num_found, num_claims, num_wrong


def _is_right(claim: Claim, change: TrueChange) -> bool:
    pairs = (claim.before, change.before), (claim.after, change.after)
    return claim.kind is change.kind and all(
        (item is None) == (true is None) and (item is None or true is None or fits(item, true))
        for item, true in pairs
    )


def _is_unknowable(claim: Claim, visits: TrueVisits) -> bool:
    """Return whether it is about an object that the first visit did not show long enough.

    Such an object may be new to the map. The same holds for a claim about an object that was
    taken or moved, if the second visit did not show its places long enough.
    """
    changed = [c for c in visits.changes if not c.is_expected]
    if any(_touches(claim, change) for change in changed):
        return True
    if claim.after is None or claim.kind is not ChangeKind.NEW:
        return False
    known = {k for k, item in visits.first.items() if item.is_expected}
    return any(fits(claim.after, item) for k, item in visits.second.items() if k not in known)


def _touches(claim: Claim, change: TrueChange) -> bool:
    items = [item for item in (claim.before, claim.after) if item is not None]
    places = [true for true in (change.before, change.after) if true is not None]
    return any(fits(item, true) for item in items for true in places)


def _numbers(
    saved: Sequence[MapObject], now: Sequence[MapObject], visits: TrueVisits
) -> tuple[int, int]:
    """Return how many unchanged objects the map has after both visits, and with one number.

    If the saved map had an object twice, either number counts.
    """
    before, after = assigned(saved, visits.first), assigned(now, visits.second)
    num_same = 0
    known = sorted(visits.unchanged & before.keys() & after.keys())
    for k in known:
        others = {item.object_id for other, item in before.items() if other != k}
        doubles = {
            item.object_id for item in saved if item.is_present and fits(item, visits.first[k])
        }
        num_same += after[k].object_id in doubles - others
    return len(known), num_same


def assigned(items: Sequence[MapObject], true: Mapping[int, TrueObject]) -> dict[int, MapObject]:
    """Return the object at rest that is assigned to each true one, by instance, where one fits."""
    at_rest = [item for item in items if item.is_present]
    instances = sorted(true)
    ratings = np.array(
        [
            [rating(_found(item), true[k]) if fits(item, true[k]) else 0.0 for item in at_rest]
            for k in instances
        ]
    ).reshape(len(instances), len(at_rest))
    rows, columns = linear_sum_assignment(ratings, maximize=True)
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return {instances[r]: at_rest[c] for r, c in pairs if ratings[r, c] > 0}


def fits(item: MapObject, true: TrueObject) -> bool:
    """Return whether an object of the map has the class and the place of a true one."""
    return item.class_name == true.class_name and rating(_found(item), true) > 0


def _found(item: MapObject) -> FoundObject:
    return FoundObject(item.class_name, PlacedBox(item.T_map_object, item.size_m))
