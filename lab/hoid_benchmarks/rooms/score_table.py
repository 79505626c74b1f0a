"""The tables of scores: a row for each room, and one for all rooms together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import numpy as np

from hoid_benchmarks.markdown import markdown_table
from hoid_benchmarks.rooms.carries import CarryScores
from hoid_benchmarks.rooms.object_scores import ObjectScores
from hoid_benchmarks.rooms.visits.change_scores import ChangeScores
from hoid_benchmarks.rooms.visits.numbers import NumberScores
from hoid_common.values import FloatArray

Scores = TypeVar('Scores', bound=tuple[Any, ...])


def total(scores: Sequence[Scores]) -> Scores:
    """Return the scores of several rooms together: the sums of the counts, and all errors."""
    columns = zip(*scores, strict=True)
    sums = (np.concatenate(c) if isinstance(c[0], np.ndarray) else sum(c) for c in columns)
    return type(scores[0])(*sums)


class ScoreTable(Generic[Scores]):
    """Collects scores by room and kind.

    Args:
        header: Titles of the columns.
        cells: Returns the cells of some scores.
    """

    def __init__(self, header: Sequence[str], cells: Callable[[Scores], Sequence[str]]) -> None:
        self._header, self._cells = header, cells
        self._scores: dict[tuple[str, ...], dict[str, Scores]] = {}

    def add(self, name: str, scores: Scores, *kind: str) -> None:
        """Add the scores of a room; the kind is shown in columns after its name."""
        self._scores.setdefault(kind, {})[name] = scores

    def text(self) -> str:
        """Return the table as Markdown; empty without scores."""
        rows: list[Sequence[str]] = []
        for kind, scores in self._scores.items():
            rows += [(f'`{name}`', *kind, *self._cells(each)) for name, each in scores.items()]
            if len(scores) > 1:
                rows.append(('all', *kind, *self._cells(total(list(scores.values())))))
        return markdown_table(self._header, rows) if rows else ''


def object_table() -> ScoreTable[ObjectScores]:
    """Return the table of objects at rest, by their source."""
    header = (
        'room', 'objects of', 'recall', 'precision', 'class right', 'doubles per object',
        'center cm', 'small: center cm', 'seen part: center cm', 'seen part: size cm',
        'large: area %',
    )  # fmt: skip
    return ScoreTable(
        header,
        lambda s: (
            _share(s.num_recalled, s.num_expected),
            _share(s.num_right, s.num_found),
            _share(s.num_class_right, s.num_right),
            f'{s.num_double / max(s.num_right, 1):.2f}',
            *map(_errors, (s.center_m, s.small_center_m, s.seen_center_m, s.size_m, s.area)),
        ),
    )


def carry_table() -> ScoreTable[CarryScores]:
    """Return the table of objects that people carry, by their source."""
    header = (
        'room', 'objects of', 'known objects carried', 'same number', 'both ends seen',
        'same number', 'put-down error cm', 'called handled', 'of these false',
    )  # fmt: skip
    return ScoreTable(
        header,
        lambda s: (
            str(s.num_known), str(s.num_kept), str(s.num_both_seen), str(s.num_both_kept),
            _errors(s.put_down_m), str(s.num_handled), str(s.num_false),
        ),
    )  # fmt: skip


def number_table() -> ScoreTable[NumberScores]:
    """Return the table of the numbers of objects."""
    header = ('room', 'loops closed', 'known early', 'same number', 'seen again', 'same number')
    return ScoreTable(header, lambda s: tuple(map(str, s)))


def change_table() -> ScoreTable[ChangeScores]:
    """Return the table of the changes between two visits, by what is done with the loaded map."""
    header = (
        'second visit', 'loaded map', 'changes found', 'wrong claims', 'F1', 'F1 of places',
        'same number', 'doubles',
    )  # fmt: skip
    return ScoreTable(
        header,
        lambda s: (
            f'{s.num_found} of {s.num_expected}', f'{s.num_wrong} of {s.num_claims}',
            f'{s.f1:.2f}', f'{s.place_f1:.2f}', f'{s.num_same} of {s.num_known}',
            str(s.num_double),
        ),
    )  # fmt: skip


def _share(part: int, whole: int) -> str:
    return f'{100 * part / whole:.1f} % of {whole}' if whole else '-'


def _errors(errors: FloatArray) -> str:
    """Return the median and the 90th percentile, in hundredths."""
    if len(errors) == 0:
        return '-'
    median, high = 100 * np.percentile(errors, (50, 90))
    return f'{median:.1f} / {high:.0f}'
