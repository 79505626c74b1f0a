"""Tables of the experiments, one function for each kind of view."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from hoid_benchmarks.jobs.masks import SHARES
from hoid_benchmarks.jobs.results import Result, Spread, key_value, removed_share, spread
from hoid_benchmarks.plan.imu_changes import NO_IMU
from hoid_benchmarks.plan.plan import Experiment, Job
from hoid_benchmarks.report.tables import (
    Cell,
    Table,
    meters,
    number,
    percent,
    reduction,
    share,
    text,
)

_ATE = key_value('ate_rmse_m')
_COVERAGE = key_value('coverage')
_METHOD = ('sequence', 'filter', 'detector')

Group = tuple[str, ...]
Rows = list[tuple[Cell, ...]]


def make_table(experiment: Experiment, results: Sequence[Result]) -> Table:
    """Return the table of an experiment; it has no rows for the view `pictures`."""
    columns, rows = _MAKERS[experiment.view](experiment, results)
    return Table(experiment.id, experiment.title, columns, tuple(rows))


def with_commits(table: Table, results: Sequence[Result]) -> Table:
    """Return the table, with a column of commits if its rows are of different commits."""
    if len({r.commit for r in results}) < 2:
        return table
    rows = ((*row, text(commits_of(results_of(row, results)))) for row in table.rows)
    return replace(table, columns=(*table.columns, 'commit'), rows=tuple(rows))


def results_of(row: Sequence[Cell], results: Sequence[Result]) -> list[Result]:
    """Return the results that a row is made from."""
    jobs = {job for cell in row for job in cell.jobs}
    return [r for r in results if r.job in jobs]


def commits_of(results: Sequence[Result]) -> str:
    """Return the commits of some results, separated by commas."""
    return ', '.join(sorted({r.commit for r in results}))


def failures(results: Sequence[Result]) -> Table:
    """Return a table of failed runs with their errors."""
    rows = [(text(r.job.label), text(r.error)) for r in results if not r.ok and not r.missing]
    return Table('failures', 'Runs that failed', ('run', 'why'), tuple(rows))


def missing(results: Sequence[Result]) -> Table:
    """Return a table of missing sequences, with the places to get them from."""
    reasons = {r.job.sequence: r.error for r in results if r.missing}
    rows = tuple((text(name), text(why)) for name, why in sorted(reasons.items()))
    return Table('missing', 'Missing sequences', ('sequence', 'what to do'), rows)


def _comparison(_: Experiment, results: Sequence[Result]) -> tuple[Group, Rows]:
    """Return the comparison of every filter with the first one, as in the paper's tables."""
    first = results[0].job.filter if results else ''
    rows = []
    for key, group in grouped(results, by_method).items():
        baseline = [r for r in results if (r.job.sequence, r.job.filter) == (key[0], first)]
        errors = []
        for name in ('ate_rmse_m', 'ate_mean_m', 'ate_median_m'):
            after = spread(group, key_value(name))
            better = improvement(baseline, group, name)
            errors += [meters(after, group), text('-') if key[1] == first else better]
        online = meters(spread(group, key_value('ate_online_rmse_m')), group)
        other = online, share(spread(group, _COVERAGE), group), _frame_times(group)
        rows.append((*map(text, key), *errors[:2], *other, *errors[2:]))
    columns = (*_METHOD, 'RMSE [m]', 'better', 'online RMSE [m]', 'coverage')
    more = 'frame [ms]: median / p95', 'mean [m]', 'better', 'median [m]', 'better'
    return (*columns, *more), rows


def _frame_times(group: Sequence[Result]) -> Cell:
    """Return a cell with the median and p95 of the time per frame; empty without timed runs."""
    median, p95 = (
        spread(group, key_value(f'stage_ms.frame.{q}')).median for q in ('median', 'p95')
    )
    cell = number(median, group)
    return replace(cell, text='' if math.isnan(median) else f'{median:.1f} / {p95:.1f}')


def improvement(
    baseline: Sequence[Result], group: Sequence[Result], name: str = 'ate_rmse_m'
) -> Cell:
    """Return a cell with the reduction of a median, empty between different commits."""
    if commits_of(baseline) != commits_of(group):
        return percent(math.nan, group)
    before, after = (spread(g, key_value(name)) for g in (baseline, group))
    return reduction(before, after, group)


def _curve(experiment: Experiment, results: Sequence[Result]) -> tuple[Group, Rows]:
    rows = [
        (
            *map(text, key[:3]),
            number(setting_of(group[0].job, experiment.varied), group),
            meters(spread(group, _ATE), group),
            share(spread(group, _COVERAGE), group),
            share(spread(group, removed_share), group),
        )
        for key, group in grouped(results, _by_setting(experiment.varied)).items()
    ]
    columns = (*_METHOD, experiment.varied, 'ATE RMSE [m]', 'coverage', 'features removed')
    return columns, rows


def _ablation(_: Experiment, results: Sequence[Result]) -> tuple[Group, Rows]:
    def key(job: Job) -> Group:
        return (job.variant or 'default', *by_method(job))

    cost = key_value('cpu_s_per_s')
    is_timed = spread(results, cost).runs > 0
    rows = [
        (
            *map(text, names),
            meters(spread(group, _ATE), group),
            share(spread(group, _COVERAGE), group),
            share(spread(group, removed_share), group),
            *[number(spread(group, cost).median, group, 2)][:is_timed],
        )
        for names, group in grouped(results, key).items()
    ]
    columns = ('variant', *_METHOD, 'ATE RMSE [m]', 'coverage', 'features removed')
    return (*columns, *['CPU s/s'][:is_timed]), rows


def _accuracy(_: Experiment, results: Sequence[Result]) -> tuple[Group, Rows]:
    rows = []
    for key, group in grouped(results, by_method).items():
        names = ('ate_rmse_m', 'ate_online_rmse_m', 'rpe_trans_1s_rmse_m')
        rows.append(
            (
                *map(text, key),
                *(meters(spread(group, key_value(name)), group) for name in names),
                number(spread(group, key_value('rpe_rot_1s_rmse_deg')).median, group, 2),
                share(spread(group, _COVERAGE), group),
                share(spread(group, _processed_share), group),
                share(spread(group, removed_share), group),
                number(spread(group, _ATE).runs, group, 0),
            )
        )
    columns = (*_METHOD, 'ATE [m]', 'online ATE [m]', 'RPE 1 s [m]', 'RPE 1 s [deg]', 'coverage')
    return (*columns, 'frames processed', 'features removed', 'runs'), rows


def _processed_share(summary: Mapping[str, Any]) -> float | None:
    total = summary.get('frames_total')
    return summary['frames_processed'] / total if total else None


def _stages(_: Experiment, results: Sequence[Result]) -> tuple[Group, Rows]:
    rows = []
    for key, group in grouped(results, by_method).items():
        spent = [r.summary.get('stage_ms', {}).items() for r in group]
        for stage in sorted({name for items in spent for name, ms in items if ms is not None}):
            times = [
                spread(group, key_value(f'stage_ms.{stage}.{q}')).median for q in ('median', 'p95')
            ]
            rows.append((*map(text, key), text(stage), *(number(t, group, 2) for t in times)))
    return (*_METHOD, 'stage', 'median [ms]', 'p95 [ms]'), rows


def _detectors(_: Experiment, results: Sequence[Result]) -> tuple[Group, Rows]:
    rows: Rows = [
        (
            text(r.job.detector),
            text(r.job.sequence),
            text(str(found.get('input', 'failed'))),
            _counted(found.get('parameters'), r),
            number(_float(found.get('latency_ms')), [r], 1),
            number(_float(found.get('recall_person')), [r], 3),
            _counted(found.get('people'), r),
            number(_float(found.get('recall_object')), [r], 3),
            _counted(found.get('objects'), r),
        )
        for r in results
        for found in [r.summary.get('detector', {})]
    ]
    columns = ('detector', 'sequence', 'input [px]', 'parameters', 'latency [ms]')
    more = ('recall, people', 'people in view', 'recall, objects', 'objects in view')
    return (*columns, *more), rows


def _verdicts(experiment: Experiment, results: Sequence[Result]) -> tuple[Group, Rows]:
    rows = [
        (
            *map(text, key[:3]),
            number(setting_of(group[0].job, experiment.varied), group),
            share(spread(group, key_value('verdicts.found_share')), group),
            share(spread(group, key_value('verdicts.spared_share')), group),
            share(spread(group, key_value('verdicts.balanced')), group),
            _wrong('wrongly_static', 'handled', group),
            _wrong('wrongly_dynamic', 'passed', group),
            meters(spread(group, _ATE), group),
            share(spread(group, _COVERAGE), group),
            share(spread(group, removed_share), group),
        )
        for key, group in grouped(results, _by_setting(experiment.varied)).items()
    ]
    columns = (*_METHOD, experiment.varied, 'handled: removed', 'passed in front of: kept')
    more = ('wrongly static', 'wrongly dynamic', 'ATE RMSE [m]', 'coverage', 'features removed')
    return (*columns, 'mean of both', *more), rows


def _wrong(name: str, of: str, group: Sequence[Result]) -> Cell:
    """Return a cell with the wrong verdicts and all verdicts, counted per object and frame."""
    wrong, every = (spread(group, key_value(f'verdicts.{key}')).median for key in (name, of))
    cell = number(wrong, group, 0)
    return cell if math.isnan(wrong) else replace(cell, text=f'{wrong:.0f} of {every:.0f}')


def _cost(experiment: Experiment, results: Sequence[Result]) -> tuple[Group, Rows]:
    names = ('stage_ms.frame.median', 'stage_ms.frame.p95', 'stage_ms.filter.median')
    rows = [
        (
            *map(text, key[:2]),
            number(setting_of(group[0].job, experiment.varied), group),
            *(number(spread(group, key_value(name)).median, group, 2) for name in names),
            number(spread(group, key_value('peak_rss_mb')).median, group, 0),
            number(spread(group, key_value('frames_processed')).median, group, 0),
            number(spread(group, key_value('keyframes')).median, group, 0),
            meters(spread(group, _ATE), group),
        )
        for key, group in grouped(results, _by_setting(experiment.varied)).items()
    ]
    columns = ('sequence', 'filter', experiment.varied, 'frame [ms]', 'frame p95 [ms]')
    more = ('filter [ms]', 'peak memory [MB]', 'frames', 'keyframes', 'ATE [m]')
    return (*columns, *more), rows


def _masks(_: Experiment, results: Sequence[Result]) -> tuple[Group, Rows]:
    rows = [
        (
            *map(text, (r.job.sequence, r.job.detector, r.job.variant or '-', variant)),
            number(frames, [r], 0),
            *(percent(100 * value, [r]) for value in shares),
        )
        for r in results
        for variant, frames, *shares in r.summary.get('masks', [])
    ]
    columns = ('sequence', 'detector', 'perturbation', 'variant', 'frames that differ')
    return (*columns, *SHARES), rows


_IMU_ERRORS = {
    'bias_5s_radps': ('bias after 5 s [rad/s]', 4),
    'offset_20s_ms': ('offset after 20 s [ms]', 1),
    'rotation_20s_deg': ('rotation after 20 s [deg]', 2),
    'tilt_2s_deg': ('tilt after 2 s [deg]', 1),
    'tilt_5s_deg': ('5 s', 1),
    'tilt_20s_deg': ('20 s', 1),
    'tilt_2s_to_last_deg': ('tilt after 2 s to the last one [deg]', 1),
    'tilt_5s_to_last_deg': ('5 s to the last one', 1),
    'bridge_deg': ('end of the black images [deg]', 2),
    'bridge_m': ('[m]', 3),
    'bridge_sigmas': ('[standard deviations]', 1),
    'after_m': ('10 images later [m]', 3),
    'reported': ('fault reported', 0),
    'gyro_used': ('gyro in use at the end', 0),
}
"""Columns of the view `imu` by error: the title and the number of decimals."""


def _imu(_: Experiment, results: Sequence[Result]) -> tuple[Group, Rows]:
    """Return a row for each variant over all sequences, with the errors known in any row."""
    known = [e for e in _IMU_ERRORS if spread(results, key_value(f'imu_errors.{e}')).runs]
    without = {_same_run(r.job): r for r in results if r.job.perturbation.imu == NO_IMU}
    rows = []
    for key, group in grouped(results, _by_variant).items():
        errors = [
            _with_range(spread(group, key_value(f'imu_errors.{e}')), group, _IMU_ERRORS[e][1])
            for e in known
        ]
        ratios = [r for one in group if (r := _ratio(one, without.get(_same_run(one.job))))]
        relative = [_with_range(spread(ratios, _ATE), group, 2)] if without else []
        runs = number(spread(group, _ATE).runs, group, 0)
        coverage = share(spread(group, _COVERAGE), group)
        rows.append(
            (
                *map(text, key),
                runs,
                meters(spread(group, _ATE), group),
                *relative,
                coverage,
                *errors,
            )
        )
    columns = ('variant', 'filter', 'runs', 'RMSE [m]', *['relative to no IMU'][: bool(without)])
    return (*columns, 'coverage', *(_IMU_ERRORS[e][0] for e in known)), rows


def _by_variant(job: Job) -> Group:
    return (job.variant or '-', job.filter)


def _same_run(job: Job) -> tuple[str, str, str, int]:
    return job.sequence, job.filter, job.detector, job.seed


def _ratio(result: Result, without: Result | None) -> Result | None:
    """Return a result whose ATE is relative to that of the same run without an IMU.

    Both are those of the images that are not black, if they are known.
    """
    both = [r.summary for r in (result, without) if r is not None and r.ok]
    seen = [key_value('imu_errors.seen_m')(summary) for summary in both]
    ends = [_ATE(summary) for summary in both] if None in seen else seen
    if len(ends) < 2 or None in ends:
        return None
    return replace(result, summary={'ate_rmse_m': ends[0] / ends[1]})


def _with_range(s: Spread, group: Sequence[Result], digits: int) -> Cell:
    """Return a cell with a median and the range over runs."""
    cell = number(s.median, group, digits)
    words = f'{cell.text} [{s.low:.{digits}f}-{s.high:.{digits}f}]'
    return replace(cell, text=words) if s.runs > 1 else cell


def _pictures(_experiment: Experiment, _results: Sequence[Result]) -> tuple[Group, Rows]:
    return (), []


_MAKERS: dict[str, Callable[[Experiment, Sequence[Result]], tuple[Group, Rows]]] = {
    'comparison': _comparison,
    'curve': _curve,
    'ablation': _ablation,
    'accuracy': _accuracy,
    'stages': _stages,
    'detectors': _detectors,
    'verdicts': _verdicts,
    'cost': _cost,
    'pictures': _pictures,
    'masks': _masks,
    'imu': _imu,
}


def setting_of(job: Job, name: str) -> float:
    """Return the value of a varied parameter or perturbation."""
    values = dict(job.parameters)
    return float(values[name] if name in values else getattr(job.perturbation, name))


def by_method(job: Job) -> Group:
    """Return the key of a method: sequence, filter and detector."""
    return (job.sequence, job.filter, job.detector or '-')


def _by_setting(varied: str) -> Callable[[Job], Group]:
    return lambda job: (*by_method(job), str(setting_of(job, varied)))


def grouped(results: Sequence[Result], key: Callable[[Job], Group]) -> dict[Group, list[Result]]:
    """Return the results grouped by a key of their jobs, in order of appearance."""
    groups: dict[Group, list[Result]] = {}
    for result in results:
        groups.setdefault(key(result.job), []).append(result)
    return groups


def _float(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def _counted(value: object, result: Result) -> Cell:
    words = f'{value:,}'.replace(',', ' ') if isinstance(value, int) else '-'
    return Cell(words, _float(value), (result.job,))
