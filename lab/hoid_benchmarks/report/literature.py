"""Tables of published values, marked as such, with a row of this project."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hoid_benchmarks.jobs.results import Result, key_value, spread
from hoid_benchmarks.report.tables import Cell, Table, meters, text
from hoid_common.io.yaml_file import read_yaml

_FILE = Path(__file__).parent / 'literature.yaml'
_ATE = key_value('ate_rmse_m')


def published(results: Sequence[Result] = ()) -> tuple[Table, ...]:
    """Return the tables of published values, which were not reproduced here.

    Args:
        results: Results of this project; if they are empty, its row is left out.
    """
    return tuple(_table(e, results) for e in read_yaml(_FILE)['tables'])


def _table(entry: Mapping[str, Any], results: Sequence[Result]) -> Table:
    rows = [tuple(_cell(value) for value in row) for row in entry['rows']]
    ours = [_ours(column, entry, results) for column in entry['columns'][1:-1]]
    if any(cell.jobs for cell in ours):
        name = ', '.join(filter(None, ('this project', entry['filter'], entry.get('detector'))))
        rows.append((text(name), *ours, text('run here, median and range')))
    return Table(entry['id'], entry['title'], tuple(entry['columns']), tuple(rows))


def _ours(column: str, entry: Mapping[str, Any], results: Sequence[Result]) -> Cell:
    method = (entry['sequences'].get(column), entry['filter'], entry.get('detector', ''))
    plain = [
        r
        for r in results
        if r.ok
        and (r.job.sequence, r.job.filter, r.job.detector) == method
        and (r.job.mode, r.job.variant) == ('offline', '')
    ]
    return meters(spread(plain, _ATE), plain) if plain else text('-')


def _cell(value: float | str) -> Cell:
    if not isinstance(value, float):
        return text(value)
    words = f'{value:.4f}'
    return Cell(words.removesuffix('0'), value)
