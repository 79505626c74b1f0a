"""The printed report of `hoid bench official`: the official sequences of a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hoid_benchmarks.jobs.results import Result, key_value, spread
from hoid_benchmarks.plan.official import WHERE, official_name
from hoid_benchmarks.plan.plan import Job, Plan
from hoid_benchmarks.report.literature import published_base, published_reduction
from hoid_benchmarks.report.tables import Cell, Table, meters, reduction, share, text
from hoid_benchmarks.report.views import make_table

OFFICIAL = 'official'
"""Name of the plan, and the argument of `hoid bench`."""
_OURS, _ORB_SLAM3 = 'table_3', 'table_3_orb_slam3'  # experiments of the plan
_OTHER = ('table_2', 'table_6')
_ATE, _COVERAGE = key_value('ate_rmse_m'), key_value('coverage')


def sequences_text(here: Sequence[str], named: Sequence[str], packed: Sequence[str]) -> str:
    """Return which sequences a folder has, and which of those with published values it lacks.

    Args:
        here: Short names of the sequences in the folder.
        named: Short names of the sequences in the paper's tables.
        packed: Archives that are not unpacked.
    """
    lines = [f'found: {", ".join(here)}']
    lines += [f'not unpacked: {", ".join(packed)}'] if packed else []
    lacking = [official_name(name) for name in named if name not in here]
    if lacking:
        lines.append(f"the paper's sequences that are not there: {', '.join(lacking)} ({WHERE})")
    return ''.join(f'{line}\n' for line in lines)


def official_text(plan: Plan, results: Mapping[Job, Result]) -> str:
    """Return the finished tables as text, and the rows in the form of README's table."""
    tables = [_overview(plan, results)]
    for experiment in plan.experiments:
        done = [results[job] for job in experiment.jobs if job in results]
        if experiment.id in _OTHER and done:
            tables.append(make_table(experiment, done))
    parts = [f'{table.title}\n\n{table.markdown()}' for table in tables if table.rows]
    if rows := _readme_rows(plan, results):
        parts.append(f'Rows of the table in README.md:\n\n{rows}')
    return ''.join(f'\n{part}' for part in parts)


def _overview(plan: Plan, results: Mapping[Job, Result]) -> Table:
    """Return the comparison of the paper (Table 3) beside this project, by sequence."""
    rows = []
    for sequence in _sequences(plan, results):
        before = _runs(plan, results, _ORB_SLAM3, sequence, 'none')
        after = _runs(plan, results, _ORB_SLAM3, sequence, 'hoid2d')
        ours = [_runs(plan, results, _OURS, sequence, name) for name in ('none', 'hoid+')]
        errors = spread(before, _ATE), spread(after, _ATE)
        rows.append(
            (
                text(sequence),
                text(' '.join(reversed(published_base(sequence))).strip() or '-'),
                _meters(before),
                _meters(after),
                reduction(*errors, after) if before and after else text('-'),
                text(published_reduction(sequence) or '-'),
                *map(_meters, ours),
                share(spread(ours[-1], _COVERAGE), ours[-1]),
            )
        )
    columns = (
        'sequence', 'without a filter, published', "ORB-SLAM3's rules", 'the same with hoid2d',
        'better', 'better in the paper', 'ours, no filter', 'ours, hoid+', 'coverage',
    )  # fmt: skip
    title = 'ATE RMSE [m], median and range of the runs, beside the paper (Table 3)'
    return Table('official', title, columns, tuple(rows))


def _meters(group: Sequence[Result]) -> Cell:
    return meters(spread(group, _ATE), group) if group else text('-')


def _readme_rows(plan: Plan, results: Mapping[Job, Result]) -> str:
    """Return a Markdown row for each sequence that has runs without a filter and with `hoid+`."""
    lines = []
    for sequence in _sequences(plan, results):
        groups = [_runs(plan, results, _OURS, sequence, name) for name in ('none', 'hoid+')]
        medians = [spread(group, _ATE) for group in groups]
        if not all(s.runs for s in medians):
            continue
        system, error = published_base(sequence)
        data, _, name = sequence.partition('_')
        origin = f'Bonn `{name}`' if data == 'bonn' else f'TUM `{sequence}`'
        base = f'{error} ({system}, published)' if system else ''
        ours = ' | '.join(f'{s.median:.4f}' for s in medians)
        detectors = ', '.join(dict.fromkeys(r.job.detector for r in groups[-1]))
        lines.append(f'| {origin} | {base} | {ours} | {detectors} |\n')
    return ''.join(lines)


def _sequences(plan: Plan, results: Mapping[Job, Result]) -> list[str]:
    """Return the sequences with a successful run, in the order of the plan."""
    done = [job for job in plan.jobs() if job in results and results[job].ok]
    return list(dict.fromkeys(job.sequence for job in done))


def _runs(
    plan: Plan, results: Mapping[Job, Result], experiment: str, sequence: str, method: str
) -> list[Result]:
    jobs = (job for e in plan.experiments if e.id == experiment for job in e.jobs)
    named = (job for job in jobs if (job.sequence, job.filter) == (sequence, method))
    return [results[job] for job in named if job in results and results[job].ok]
