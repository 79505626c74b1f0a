"""Tables of cells, as CSV and Markdown; `page.py` renders them as HTML."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass

from hoid_benchmarks.jobs.results import Result, Spread
from hoid_benchmarks.plan.plan import Job

EQUAL = 'equal'
"""Text of a difference that is within the range of the runs."""


@dataclass(frozen=True)
class Cell:
    """One cell: its text, a number for sorting (NaN for text), and the runs it is made from."""

    text: str
    value: float = math.nan
    jobs: tuple[Job, ...] = ()


@dataclass(frozen=True)
class Table:
    """A titled grid of cells."""

    id: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def csv(self) -> str:
        """Return the table as CSV."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator='\n')
        writer.writerow(self.columns)
        writer.writerows([cell.text for cell in row] for row in self.rows)
        return out.getvalue()

    def markdown(self) -> str:
        """Return the table as GitHub Markdown."""
        lines = ['| ' + ' | '.join(self.columns) + ' |', '|' + '---|' * len(self.columns)]
        lines += ['| ' + ' | '.join(cell.text for cell in row) + ' |' for row in self.rows]
        return '\n'.join(lines) + '\n'


def text(words: str) -> Cell:
    """Return a cell of text without runs."""
    return Cell(words)


def meters(s: Spread, group: Sequence[Result]) -> Cell:
    """Return a cell with a median in m and the range over runs."""
    if s.runs == 0:
        failed = any(not r.ok for r in group)
        return Cell('failed' if failed else 'none', math.inf, _jobs(group))
    words = f'{s.median:.4f}'
    if s.runs > 1:
        words += f' [{s.low:.4f}-{s.high:.4f}]'
    return Cell(words, s.median, _jobs(group))


def share(s: Spread, group: Sequence[Result]) -> Cell:
    """Return a cell with a share in [0, 1]."""
    return number(s.median, group, 3)


def percent(value: float, group: Sequence[Result]) -> Cell:
    """Return a cell with a percentage."""
    return Cell('-' if math.isnan(value) else f'{value:.1f} %', value, _jobs(group))


def reduction(before: Spread, after: Spread, group: Sequence[Result]) -> Cell:
    """Return a cell with the reduction of a median in percent.

    The text is `EQUAL` if the ranges of the runs overlap: then the difference is not known to be
    more than the variation between runs.
    """
    if before.overlaps(after):
        return Cell(EQUAL, 0.0, _jobs(group))
    return percent(100 * (1 - after.median / before.median) if before.median else math.nan, group)


def number(value: float, group: Sequence[Result], digits: int | None = None) -> Cell:
    """Return a cell with a number of fixed decimals, or as short as possible without `digits`."""
    if math.isnan(value):
        return Cell('-', value, _jobs(group))
    return Cell(f'{value:g}' if digits is None else f'{value:.{digits}f}', value, _jobs(group))


def _jobs(group: Sequence[Result]) -> tuple[Job, ...]:
    return tuple(r.job for r in group)
