"""Outcomes of the cases of the campaign, and their table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from statistics import median
from typing import NamedTuple

_HEAD_LINES = 2


class Outcome(NamedTuple):
    """Outcome of one case."""

    kind: str
    seed: int
    complaint: str  # what the oracle found wrong; empty if the case passed
    was_refused: bool = False
    wall_s: float = 0.0
    peak_mb: float = 0.0
    note: str = ''  # a measured value, as text
    # The row of a kind shows the note of the highest rank; None: wall_s.
    note_rank: float | None = None
    number: int = 1  # of faults that were checked together
    skipped: str = ''  # why the case was not run; empty if it was


def table(outcomes: Iterable[Outcome]) -> str:
    """Return a Markdown table with a row for each kind, and a line for each failed case."""
    by_kind: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        by_kind.setdefault(outcome.kind, []).append(outcome)
    lines = [
        '| what was tried | cases | as they must | refused | median | slowest | most memory | |',
        '|---|--:|--:|--:|--:|--:|--:|---|',
        *(_row(kind, found) for kind, found in by_kind.items()),
    ]
    failed = [o for found in by_kind.values() for o in found if o.complaint]
    lines += [''] * bool(failed)
    lines += [f'- {o.kind}, seed {o.seed}: {o.complaint}' for o in failed]
    return '\n'.join(lines) + '\n'


def merged(before: str, after: str) -> str:
    """Return a table in which the rows of a later table replace those of the same kind."""
    head: list[str] = []
    rows: dict[str, str] = {}
    for line in (*before.splitlines(), *after.splitlines()):
        if line.startswith('| ') and not line.startswith('| what'):
            rows[line.split('|')[1]] = line
        elif line.startswith('|') and len(head) < _HEAD_LINES:
            head.append(line)
    return '\n'.join((*head, *rows.values())) + '\n'


def totals(outcomes: Iterable[Outcome]) -> Mapping[str, int]:
    """Return the number of cases, and how many of them failed."""
    every = list(outcomes)
    return {'cases': len(every), 'failed': sum(bool(o.complaint) for o in every)}


def _row(kind: str, found: list[Outcome]) -> str:
    skipped = next((o.skipped for o in found if o.skipped), '')
    if skipped:
        return f'| {kind} | 0 | - | - | - | - | - | skipped: {skipped} |'
    tried, good = sum(o.number for o in found), sum(o.number * (not o.complaint) for o in found)
    refused = sum(o.was_refused for o in found)
    times_s, most = [o.wall_s for o in found], max(o.peak_mb for o in found)
    memory = f'{most:.0f} MB' if most else '-'
    note = max(found, key=_badness).note or '-'
    times = f'{median(times_s):.1f} s | {max(times_s):.1f} s'
    numbers = f'{tried} | {good} | {refused} | {times} | {memory}'
    return f'| {kind} | {numbers} | {note} |'


def _badness(outcome: Outcome) -> tuple[bool, float]:
    rank = outcome.note_rank
    return bool(outcome.complaint), outcome.wall_s if rank is None else rank
