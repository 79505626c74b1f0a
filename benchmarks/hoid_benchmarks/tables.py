"""Tables of the experiments, as CSV, Markdown and HTML rows."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hoid_benchmarks.plan import Experiment, Job
from hoid_benchmarks.results import Result, Spread, key_value, removed_share, spread

_ATE = key_value('ate_rmse_m')
_COVERAGE = key_value('coverage')


@dataclass(frozen=True)
class Cell:
    """One cell: text for the reader, number for sorting, and the runs it came from."""

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


Group = tuple[str, ...]


def make_table(experiment: Experiment, results: Sequence[Result]) -> Table:
    """Return the experiment's table, by its view."""
    makers: dict[str, Callable[[Experiment, Sequence[Result]], Table]] = {
        'comparison': _comparison,
        'curve': _curve,
        'ablation': _ablation,
        'accuracy': _accuracy,
        'stages': _stages,
        'detectors': _detectors,
        'cost': _cost,
    }
    return makers[experiment.view](experiment, results)


def failures(results: Sequence[Result]) -> Table:
    """Return the runs that failed, with the reason."""
    rows = [(_text(r.job.label), _text(r.error)) for r in results if not r.ok]
    return Table('failures', 'Runs that failed', ('run', 'why'), tuple(rows))


def _comparison(experiment: Experiment, results: Sequence[Result]) -> Table:
    """Compare every filter with the first one, in the paper's form."""
    rows = []
    for (sequence, method, detector), group in _grouped(results, _by_method).items():
        baseline = [
            r
            for r in results
            if r.job.sequence == sequence and r.job.filter == results[0].job.filter
        ]
        cells = [_text(sequence), _text(method), _text(detector or '-')]
        for name in ('ate_rmse_m', 'ate_mean_m', 'ate_median_m'):
            after, before = (spread(g, key_value(name)) for g in (group, baseline))
            better = 100 * (1 - after.median / before.median) if before.median else math.nan
            same = method == results[0].job.filter
            cells += [_metres(after, group), _text('-') if same else _percent(better, group)]
        rows.append((*cells, _share(spread(group, _COVERAGE), group)))
    columns = ('sequence', 'filter', 'detector', 'RMSE [m]', 'better', 'mean [m]', 'better')
    return _table(experiment, (*columns, 'median [m]', 'better', 'coverage'), rows)


def _curve(experiment: Experiment, results: Sequence[Result]) -> Table:
    rows = [
        (
            *map(_text, group_key),
            _number(setting_of(group[0].job, experiment.varied), group),
            _metres(spread(group, _ATE), group),
            _share(spread(group, _COVERAGE), group),
            _share(spread(group, removed_share), group),
        )
        for group_key, group in _grouped(results, _by_setting(experiment.varied)).items()
        for group_key in [group_key[:3]]
    ]
    columns = ('sequence', 'filter', 'detector', experiment.varied, 'ATE RMSE [m]', 'coverage')
    return _table(experiment, (*columns, 'features removed'), rows)


def _ablation(experiment: Experiment, results: Sequence[Result]) -> Table:
    def key(job: Job) -> Group:
        return (variant_of(job), job.sequence, job.detector)

    rows = [
        (
            *map(_text, group_key),
            _metres(spread(group, _ATE), group),
            _share(spread(group, _COVERAGE), group),
            _share(spread(group, removed_share), group),
        )
        for group_key, group in _grouped(results, key).items()
    ]
    columns = ('variant', 'sequence', 'detector', 'ATE RMSE [m]', 'coverage', 'features removed')
    return _table(experiment, columns, rows)


def _accuracy(experiment: Experiment, results: Sequence[Result]) -> Table:
    rows = []
    for group_key, group in _grouped(results, _by_method).items():
        metres = ('ate_rmse_m', 'ate_online_rmse_m', 'rpe_trans_1s_rmse_m')
        rows.append(
            (
                *map(_text, group_key),
                *(_metres(spread(group, key_value(name)), group) for name in metres),
                _number(spread(group, key_value('rpe_rot_1s_rmse_deg')).median, group, 2),
                _share(spread(group, _COVERAGE), group),
                _share(spread(group, removed_share), group),
                _number(spread(group, _ATE).runs, group, 0),
            )
        )
    columns = ('sequence', 'filter', 'detector', 'ATE [m]', 'online ATE [m]', 'RPE 1 s [m]')
    more = ('RPE 1 s [deg]', 'coverage', 'features removed', 'runs')
    return _table(experiment, (*columns, *more), rows)


def _stages(experiment: Experiment, results: Sequence[Result]) -> Table:
    rows = []
    for group_key, group in _grouped(results, _by_method).items():
        stages = sorted({s for r in group for s in r.summary.get('stage_ms', {})})
        for stage in stages:
            times = [
                spread(group, key_value(f'stage_ms.{stage}.{q}')).median for q in ('median', 'p95')
            ]
            rows.append(
                (*map(_text, group_key), _text(stage), *(_number(t, group, 2) for t in times))
            )
    columns = ('sequence', 'filter', 'detector', 'stage', 'median [ms]', 'p95 [ms]')
    return _table(experiment, columns, rows)


def _detectors(experiment: Experiment, results: Sequence[Result]) -> Table:
    names = ('input', 'parameters', 'latency_ms', 'recall_person', 'recall_object', 'precision')
    rows = []
    for (detector, sequence), group in _grouped(
        results, lambda job: (job.detector, job.sequence)
    ).items():
        values = [key_value(f'detector.{name}')(group[0].summary) for name in names]
        cells = [
            _text('-' if v is None else f'{v:.3g}' if isinstance(v, float) else str(v))
            for v in values
        ]
        rows.append((_text(detector), _text(sequence), *cells))
    columns = ('detector', 'sequence', 'input', 'parameters', 'latency [ms]')
    return _table(experiment, (*columns, 'recall people', 'recall objects', 'precision'), rows)


def _cost(experiment: Experiment, results: Sequence[Result]) -> Table:
    rows = [
        (
            _text(group[0].job.sequence),
            _text(group[0].job.filter),
            _number(setting_of(group[0].job, experiment.varied), group),
            _number(spread(group, key_value('stage_ms.frame.median')).median, group, 2),
            _number(spread(group, key_value('stage_ms.frame.p95')).median, group, 2),
            _number(spread(group, key_value('peak_rss_mb')).median, group, 0),
            _number(spread(group, key_value('keyframes')).median, group, 0),
            _metres(spread(group, _ATE), group),
        )
        for group in _grouped(results, _by_setting(experiment.varied)).values()
    ]
    columns = ('sequence', 'filter', experiment.varied, 'frame median [ms]', 'frame p95 [ms]')
    return _table(experiment, (*columns, 'peak memory [MB]', 'keyframes', 'ATE [m]'), rows)


def setting_of(job: Job, name: str) -> float:
    """Return the value of a varied parameter or perturbation."""
    values = dict(job.parameters)
    return float(values[name] if name in values else getattr(job.perturbation, name))


def variant_of(job: Job) -> str:
    """Return the parameters that a job sets, for people."""
    return ', '.join(f'{k}={v}' for k, v in job.parameters) or 'default'


def _by_method(job: Job) -> Group:
    return (job.sequence, job.filter, job.detector)


def _by_setting(varied: str) -> Callable[[Job], Group]:
    return lambda job: (*_by_method(job), str(setting_of(job, varied)))


def _grouped(results: Sequence[Result], key: Callable[[Job], Group]) -> dict[Group, list[Result]]:
    groups: dict[Group, list[Result]] = {}
    for result in results:
        groups.setdefault(key(result.job), []).append(result)
    return groups


def _table(
    experiment: Experiment, columns: tuple[str, ...], rows: Sequence[tuple[Cell, ...]]
) -> Table:
    return Table(experiment.id, experiment.title, columns, tuple(rows))


def _text(text: str) -> Cell:
    return Cell(text)


def _any(value: object) -> Cell:
    if value is None:
        return _text('-')
    return _text(f'{value:.3g}' if isinstance(value, float) else str(value))


def _jobs(group: Sequence[Result]) -> tuple[Job, ...]:
    return tuple(r.job for r in group)


def _metres(s: Spread, group: Sequence[Result]) -> Cell:
    if s.runs == 0:
        return Cell('no result', math.inf, _jobs(group))
    text = f'{s.median:.4f}'
    return Cell(
        f'{text} [{s.low:.4f}-{s.high:.4f}]' if s.runs > 1 else text, s.median, _jobs(group)
    )


def _share(s: Spread, group: Sequence[Result]) -> Cell:
    return Cell('-' if s.runs == 0 else f'{s.median:.3f}', s.median, _jobs(group))


def _percent(value: float, group: Sequence[Result]) -> Cell:
    return Cell('-' if math.isnan(value) else f'{value:.1f} %', value, _jobs(group))


def _number(value: float, group: Sequence[Result], digits: int | None = None) -> Cell:
    if math.isnan(value):
        return Cell('-', value, _jobs(group))
    return Cell(f'{value:g}' if digits is None else f'{value:.{digits}f}', value, _jobs(group))
