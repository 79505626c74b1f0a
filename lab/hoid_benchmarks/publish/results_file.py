"""The file of results shown in the documents: each row has its commit and machine."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from hoid_benchmarks.jobs.results import Result
from hoid_benchmarks.plan.plan import Experiment, Job, Plan
from hoid_benchmarks.report.tables import Cell
from hoid_benchmarks.report.views import commits_of, make_table, results_of
from hoid_common.errors import InputError

_MOST_COLUMNS = {'comparison': 8}  # without mean and median of the ATE


@dataclass(frozen=True)
class Row:
    """One row of a table in the documents."""

    cells: tuple[str, ...]
    commit: str  # commit of its runs; several are separated by commas
    machine: str


@dataclass(frozen=True)
class Kept:
    """The stored table of an experiment."""

    columns: tuple[str, ...]
    rows: tuple[Row, ...]


def select_columns(kept: Kept, names: Sequence[str]) -> Kept:
    """Return the table with these columns only.

    Raises:
        InputError: There is no column of such a name.
    """
    missing = set(names) - {*kept.columns}
    if missing:
        raise InputError(f'no column {", ".join(sorted(missing))} among {", ".join(kept.columns)}')
    at = [kept.columns.index(name) for name in names]
    rows = tuple(replace(row, cells=tuple(row.cells[k] for k in at)) for row in kept.rows)
    return Kept(tuple(names), rows)


def select_rows(kept: Kept, column: str, names: Sequence[str]) -> Kept:
    """Return the table with the rows that have one of these names in a column."""
    at = kept.columns.index(column)
    return replace(kept, rows=tuple(row for row in kept.rows if row.cells[at] in names))


def read_kept(path: Path) -> dict[str, Kept]:
    """Return the stored tables by name of the experiment; empty if there is no file.

    Raises:
        InputError: The file is damaged.
    """
    if not path.is_file():
        return {}
    try:
        return {
            name: Kept(
                tuple(kept['columns']),
                tuple(Row(tuple(r['cells']), r['commit'], r['machine']) for r in kept['rows']),
            )
            for name, kept in json.loads(path.read_text(encoding='utf-8')).items()
        }
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f'{path}: not a file of results: {error}') from error


def write_kept(path: Path, kept: Mapping[str, Kept]) -> None:
    """Write all experiments with one row per line, so that diffs show the changed rows."""
    parts = []
    for name, one in kept.items():
        rows = ',\n'.join(f'  {json.dumps(asdict(row))}' for row in one.rows)
        columns = json.dumps(one.columns)
        parts.append(f'{json.dumps(name)}: {{"columns": {columns}, "rows": [\n{rows}\n]}}')
    path.write_text('{\n' + ',\n'.join(parts) + '\n}\n', encoding='utf-8')


def keep(plan: Plan, results: Mapping[Job, Result], path: Path) -> tuple[str, ...]:
    """Store every experiment whose runs all succeeded; return the names of these experiments.

    An incomplete experiment keeps its stored rows and their commit.
    """
    kept, new = read_kept(path), []
    for experiment in plan.experiments:
        every = [results[job] for job in experiment.jobs if job in results]
        if len(every) == len(experiment.jobs) and all(r.ok for r in every):
            kept[experiment.id] = _kept(experiment, every)
            new.append(experiment.id)
    write_kept(path, kept)
    return tuple(new)


def _kept(experiment: Experiment, results: list[Result]) -> Kept:
    table = make_table(experiment, results)
    most = _MOST_COLUMNS.get(experiment.view, len(table.columns))
    return Kept(table.columns[:most], tuple(_row(cells, results, most) for cells in table.rows))


def _row(cells: Sequence[Cell], results: Sequence[Result], most: int) -> Row:
    of = results_of(cells, results)
    machines = sorted({r.machine for r in of})
    return Row(tuple(c.text for c in cells[:most]), commits_of(of), '; '.join(machines))
