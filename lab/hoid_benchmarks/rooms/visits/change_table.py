"""The table of rearranged rooms: which changes the object map finds at a second visit."""

from __future__ import annotations

from hoid_benchmarks.rooms.visits.change_scores import ChangeScores, all_changes, score_changes
from hoid_benchmarks.rooms.visits.second_visit import Visits
from hoid_benchmarks.rooms.visits.true_changes import TrueVisits

HEADER = (
    'second visit', 'loaded map', 'changes found', 'wrong claims', 'F1', 'F1 of places',
    'same number', 'doubles',
)  # fmt: skip


class ChangeTable:
    """Collects the scores of rooms."""

    def __init__(self) -> None:
        self._scores: dict[str, dict[str, ChangeScores]] = {}  # by mode and room

    def add(self, name: str, visits: Visits, true: TrueVisits) -> None:
        """Score the two visits of a room."""
        for mode, now in visits.now.items():
            self._scores.setdefault(mode, {})[name] = score_changes(visits.saved, now, true)

    def rows(self) -> list[tuple[str, ...]]:
        """Return the cells of all rooms, and of all together."""
        out: list[tuple[str, ...]] = []
        for mode, scores in self._scores.items():
            out += [(f'`{name}`', mode, *_cells(score)) for name, score in scores.items()]
            if len(scores) > 1:
                out.append(('all', mode, *_cells(all_changes(scores.values()))))
        return out


def _cells(scores: ChangeScores) -> tuple[str, ...]:
    return (
        f'{scores.num_found} of {scores.num_expected}',
        f'{scores.num_wrong} of {scores.num_claims}',
        f'{scores.f1:.2f}',
        f'{scores.place_f1:.2f}',
        f'{scores.num_same} of {scores.num_known}',
        str(scores.num_double),
    )
