"""Compact tables of errors for the pages: settings against sequences.

The files of results have a row for each run setting of each sequence, with online errors, times
and more. A page shows the error of the final trajectory only.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from hoid_benchmarks.publish.results_file import Row

_SEQUENCE, _BETTER, _COVERAGE = 'sequence', 'better', 'coverage'
_EMPTY = ('', '-')


class Table(NamedTuple):
    """Heads and rows of a table, and what its cells show."""

    heads: tuple[str, ...]
    rows: list[tuple[str, ...]]
    caption: str


def error_table(columns: Sequence[str], rows: Sequence[Row]) -> Table:
    """Return the errors with one cell per sequence and setting, the longer list downwards.

    A setting is everything before the error but the sequence: variant, filter, detector and so
    on. Where the rows are of several commits, the commit is a part of the setting.
    """
    error_at = next(k for k, column in enumerate(columns) if 'RMSE [m]' in column)
    sequence_at = columns.index(_SEQUENCE)
    names = [k for k in range(error_at) if k != sequence_at]
    # A column without any entry, such as the detector of runs without one, says nothing.
    shown = [k for k in names if any(row.cells[k] not in _EMPTY for row in rows)]
    mixed = len({row.commit for row in rows}) > 1
    cells: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows:
        setting = (*(row.cells[k] for k in shown), *((row.commit,) if mixed else ()))
        cells.setdefault(setting, {})[row.cells[sequence_at]] = _cell(columns, row, error_at)
    sequences = tuple(dict.fromkeys(row.cells[sequence_at] for row in rows))
    caption = f'{columns[error_at].replace(" [m]", " in m")}.'
    if len(sequences) >= len(cells) and not mixed:
        settings = (', '.join(n for n in setting if n not in _EMPTY) for setting in cells)
        lines = [(s, *(of.get(s, '') for of in cells.values())) for s in sequences]
        return Table((_SEQUENCE, *settings), lines, caption)
    heads = (*(columns[k] for k in shown), *(('commit',) if mixed else ()), *sequences)
    lines = [(*setting, *(of.get(s, '') for s in sequences)) for setting, of in cells.items()]
    return Table(heads, lines, caption)


def _cell(columns: Sequence[str], row: Row, error_at: int) -> str:
    """Return the error, bold if better, slanted if worse, and the coverage if it is partial."""
    text = row.cells[error_at]
    by_name = dict(zip(columns, row.cells, strict=True))
    change = by_name.get(_BETTER, '')
    if change.endswith('%'):
        mark = '_' if change.startswith('-') else '**'
        median, _, spread = text.partition(' ')
        text = f'{mark}{median}{mark} {spread}'.strip()
    coverage = by_name.get(_COVERAGE, '')
    return text if coverage in (*_EMPTY, '1.000') else f'{text}, coverage {coverage}'
