"""Tables of published values, marked as such, with a row of this project."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hoid_benchmarks.jobs.results import Result, key_value, spread
from hoid_benchmarks.report.tables import Cell, Table, meters, text
from hoid_benchmarks.report.views import grouped
from hoid_common.io.yaml_file import read_yaml

_FILE = Path(__file__).parent / 'literature.yaml'
_PAPER = 'HOID against ORB-SLAM3'  # row with the reductions that the HOID paper states
_ATE = key_value('ate_rmse_m')


def published(results: Sequence[Result] = ()) -> tuple[Table, ...]:
    """Return the tables of published values, which were not reproduced here.

    Args:
        results: Results of this project; if they are empty, its row is left out.
    """
    return tuple(_table(e, results) for e in read_yaml(_FILE)['tables'])


def own_names(table_id: str) -> Mapping[str, str]:
    """Return the names that this project has for the sequences of a table, by column."""
    (entry,) = (e for e in read_yaml(_FILE)['tables'] if e['id'] == table_id)
    names: Mapping[str, str] = entry['sequences']
    return names


def published_base(sequence: str) -> tuple[str, str]:
    """Return the name and the published ATE of a system without a filter; empty if unknown."""
    for entry, row, column in _columns_of(sequence):
        if entry['base'] and row[0] == entry['base'] and row[column] != '-':
            return str(row[0]), _cell(row[column]).text
    return '', ''


def published_reduction(sequence: str) -> str:
    """Return by how much the paper's HOID reduces the error of ORB-SLAM3; empty if unknown."""
    for _, row, column in _columns_of(sequence):
        if row[0] == _PAPER and row[column] != '-':
            return str(row[column]).removesuffix(' better')
    return ''


def _columns_of(sequence: str) -> Iterator[tuple[Mapping[str, Any], Sequence[float | str], int]]:
    """Yield each table that has a sequence, with each of its rows and the sequence's column."""
    for entry in read_yaml(_FILE)['tables']:
        for name, own in entry['sequences'].items():
            if own == sequence:
                column = entry['columns'].index(name)
                yield from ((entry, row, column) for row in entry['rows'])


def _table(entry: Mapping[str, Any], results: Sequence[Result]) -> Table:
    rows = [tuple(_cell(value) for value in row) for row in entry['rows']]
    named = set(entry['sequences'].values())
    mine = [r for r in results if _is_plain(r, entry['filter']) and r.job.sequence in named]
    for (detector,), group in grouped(mine, lambda job: (job.detector,)).items():
        ours = [_ours(entry['sequences'].get(c), group) for c in entry['columns'][1:-1]]
        name = ', '.join(filter(None, ('this project', entry['filter'], detector)))
        rows.append((text(name), *ours, text('run here, median and range')))
    return Table(entry['id'], entry['title'], tuple(entry['columns']), tuple(rows))


def _is_plain(result: Result, method: str) -> bool:
    """Return whether a successful run used a filter with the default values of everything."""
    job = result.job
    return result.ok and (job.filter, job.mode, job.variant) == (method, 'offline', '')


def _ours(sequence: str | None, results: Sequence[Result]) -> Cell:
    here = [r for r in results if r.job.sequence == sequence]
    return meters(spread(here, _ATE), here) if here else text('-')


def _cell(value: float | str) -> Cell:
    if not isinstance(value, float):
        return text(value)
    words = f'{value:.4f}'
    return Cell(words.removesuffix('0'), value)
