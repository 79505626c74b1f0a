"""The table of carried objects: whether the maps follow them from place to place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_benchmarks.rooms.carries import CarryScores, score_carries, true_carries
from hoid_benchmarks.rooms.object_truth import TrueObject
from hoid_benchmarks.rooms.room_run import MappedRoom
from hoid_common.values import FloatArray
from hoid_synth.room_truth import RoomTruth

HEADER = (
    'room', 'known objects carried', 'same number', 'put-down error cm', 'called handled',
    'of these false', 'new places filled',
)  # fmt: skip
# A place is filled if the dense map has points within this distance of this share of the surface
# that was seen there.
_NEAR_M, _FILLED_SHARE = 0.03, 0.5


class CarryTable:
    """Collects the scores of rooms."""

    def __init__(self) -> None:
        self._scores: list[CarryScores] = []
        self._rows: list[tuple[str, ...]] = []
        self._filled: list[tuple[int, int]] = []  # filled places of all, by room

    def add(
        self,
        name: str,
        room: MappedRoom,
        truth: RoomTruth,
        sequence: BagSequence,
        true: Sequence[TrueObject],
    ) -> None:
        """Score a room: its object map by the carries, its dense map by the last places."""
        scores = score_carries(room.history, true_carries(truth, sequence), truth)
        filled = count_filled(true, room.cloud.points_m.astype(np.float64))
        self._scores.append(scores)
        self._filled.append(filled)
        self._rows.append((f'`{name}`', *_cells(scores, filled)))

    def rows(self) -> list[tuple[str, ...]]:
        """Return the cells of all rooms, and of all together."""
        if len(self._rows) < 2:
            return self._rows
        counts = [sum(column) for column in zip(*(_counts(s) for s in self._scores), strict=True)]
        all_filled = [sum(column) for column in zip(*self._filled, strict=True)]
        errors_m = np.concatenate([s.put_down_m for s in self._scores])
        total = CarryScores(counts[0], counts[1], errors_m, counts[2], counts[3])
        return [*self._rows, ('all', *_cells(total, all_filled))]


def count_filled(true: Sequence[TrueObject], points_map_m: FloatArray) -> tuple[int, int]:
    """Return how many carried objects the dense map shows at their last place, and of how many.

    Args:
        true: The true objects, of which those that were carried and shown long enough count.
        points_map_m: (N, 3) points of the dense map.
    """
    carried = [item for item in true if item.was_carried and item.is_expected]
    if not carried or len(points_map_m) == 0:
        return 0, len(carried)
    tree = cKDTree(points_map_m)
    shares = [
        np.isfinite(tree.query(item.seen_m, distance_upper_bound=_NEAR_M)[0]).mean()
        for item in carried
    ]
    return sum(bool(share >= _FILLED_SHARE) for share in shares), len(carried)


def _counts(scores: CarryScores) -> tuple[int, int, int, int]:
    return scores.num_known, scores.num_kept, scores.num_handled, scores.num_false


def _cells(scores: CarryScores, filled: Sequence[int]) -> tuple[str, ...]:
    errors_cm = 100 * scores.put_down_m
    median, high = np.percentile(errors_cm, (50, 90)) if len(errors_cm) else (np.nan, np.nan)
    return (
        str(scores.num_known),
        str(scores.num_kept),
        f'{median:.1f} / {high:.0f}' if len(errors_cm) else '-',
        str(scores.num_handled),
        str(scores.num_false),
        f'{filled[0]} of {filled[1]}',
    )
