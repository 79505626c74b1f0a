"""Figures of the experiments as plotly figures for the page; `figure_files.py` saves them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoid_benchmarks.jobs.results import Result, key_value, result_path, spread
from hoid_benchmarks.plan.plan import Experiment
from hoid_benchmarks.report.views import setting_of
from hoid_bringup.evaluate.evaluation import AlignedTrajectory, align
from hoid_common.io.tum_text import read_tum
from hoid_common.values import S_PER_NS, FloatArray, IntArray

Plot = dict[str, Any]  # a plotly figure: data and layout
_VALUES = {
    'curve': (('ate_rmse_m', 'ATE RMSE [m]'), ('coverage', 'coverage')),
    'verdicts': (
        ('verdicts.found_share', 'handled objects removed'),
        ('verdicts.spared_share', 'objects passed in front of that are kept'),
        ('verdicts.balanced', 'mean of both'),
        ('ate_rmse_m', 'ATE RMSE [m]'),
    ),
    'cost': (('stage_ms.frame.median', 'time per frame [ms]'), ('peak_rss_mb', 'memory [MB]')),
}
_MAX_POINTS = 1500  # of a drawn trajectory, to limit the size of the page
_WIDE_RANGE = 10.0  # ratio of largest to smallest value from which an axis is logarithmic
_FEATURES = 'features.csv'
TRUTH = 'ground truth'
_TIME = 'time [s]'


def make_plots(
    experiment: Experiment, results: Sequence[Result], folder: Path
) -> tuple[Plot, ...]:
    """Return the interactive plots of an experiment; runs whose files are missing are left out."""
    if experiment.view in _VALUES:
        plots = (
            _curve_plot(experiment, results, name, label)
            for name, label in _VALUES[experiment.view]
        )
        return tuple(plot for plot in plots if not _is_constant(plot))
    if experiment.view == 'comparison':
        return tuple(
            plot
            for sequence in dict.fromkeys(r.job.sequence for r in results)
            for plot in _trajectory_plots(sequence, _first_runs(results, sequence), folder)
        )
    return ()


def _is_constant(plot: Plot) -> bool:
    """Return whether all values of a plot are equal."""
    return len({y for trace in plot['data'] for y in trace['y']}) <= 1


def _plot(title: str, x: str, y: str, data: list[Plot], **yaxis: Any) -> Plot:
    return {
        'data': data,
        'layout': {
            'title': {'text': title},
            'xaxis': {'title': {'text': x}},
            'yaxis': {'title': {'text': y}, **yaxis},
        },
    }


def _line(name: str, x: Sequence[float], y: Sequence[float], **more: Any) -> Plot:
    return {'type': 'scatter', 'mode': 'lines+markers', 'name': name, 'x': x, 'y': y, **more}


def _curve_plot(experiment: Experiment, results: Sequence[Result], name: str, label: str) -> Plot:
    data = []
    for sequence, method, detector in dict.fromkeys(
        (r.job.sequence, r.job.filter, r.job.detector) for r in results
    ):
        mine = [
            r
            for r in results
            if (r.job.sequence, r.job.filter, r.job.detector) == (sequence, method, detector)
        ]
        xs = sorted({setting_of(r.job, experiment.varied) for r in mine})
        groups = [[r for r in mine if setting_of(r.job, experiment.varied) == x] for x in xs]
        spreads = [spread(group, key_value(name)) for group in groups]
        drawn = [(x, s) for x, s in zip(xs, spreads, strict=True) if s.runs]
        data.append(
            _line(
                ' '.join(filter(None, (sequence, method, detector))),
                [x for x, _ in drawn],
                [s.median for _, s in drawn],
                error_y={
                    'type': 'data',
                    'array': [s.high - s.median for _, s in drawn],
                    'arrayminus': [s.median - s.low for _, s in drawn],
                },
            )
        )
    plot = _plot(
        f'{experiment.title}: {label}', experiment.varied, label, data, rangemode='tozero'
    )
    values = [x for trace in data for x in trace['x']]
    if values and min(values) > 0 and max(values) / min(values) >= _WIDE_RANGE:
        plot['layout']['xaxis']['type'] = 'log'
    return plot


def _first_runs(results: Sequence[Result], sequence: str) -> list[Result]:
    runs: dict[tuple[str, str], Result] = {}
    for r in results:
        if r.ok and r.job.sequence == sequence:
            runs.setdefault((r.job.filter, r.job.detector), r)
    return list(runs.values())


def _trajectory_plots(sequence: str, runs: Sequence[Result], folder: Path) -> list[Plot]:
    """Draw the paper's Figures 8 and 9, the error over time, and the features kept, by filter."""
    above: list[Plot] = []
    error: list[Plot] = []
    kept: list[Plot] = []
    for r in runs:
        run = result_path(folder, r.job).parent
        if not (run / 'ground_truth.txt').is_file():
            continue
        aligned = align(read_tum(run / 'trajectory.txt'), read_tum(run / 'ground_truth.txt'))
        name = ' '.join(filter(None, (r.job.filter, r.job.detector)))
        axes = _widest_plane(aligned)
        if not above:
            above.append(_path(TRUTH, aligned.T_world_camera_true, axes))
        above.append(_path(name, aligned.T_world_camera, axes))
        first_ns = aligned.stamps_ns[0]
        error.append(_over_time(name, aligned.stamps_ns - first_ns, aligned.error_m))
        if (run / _FEATURES).is_file():
            stamps_ns, number = np.loadtxt(
                run / _FEATURES, np.int64, delimiter=',', skiprows=1, ndmin=2
            ).T
            kept.append(_over_time(name, stamps_ns - first_ns, number))
    if not above:
        return []
    x, y = (f'{"xyz"[k]} [m]' for k in axes)
    plots = [
        _plot(f'{sequence}: trajectories', x, y, above, scaleanchor='x'),
        _plot(f'{sequence}: error over time', _TIME, 'error [m]', error, rangemode='tozero'),
    ]
    title = f'{sequence}: features kept over time'
    plots.append(_plot(title, _TIME, 'features', kept, rangemode='tozero'))
    return [plot for plot in plots if not _is_constant(plot)]


def _over_time(name: str, since_ns: IntArray, values: NDArray[np.generic]) -> Plot:
    keep = slice(None, None, _step(len(values)))
    return _line(name, _floats(since_ns[keep] * S_PER_NS), _floats(values[keep]), mode='lines')


def _widest_plane(aligned: AlignedTrajectory) -> tuple[int, int]:
    """Return the two world axes along which the true camera moved most, in ascending order."""
    spans_m = np.ptp(aligned.T_world_camera_true[:, :3, 3], axis=0)
    first, second = sorted(np.argsort(-spans_m, kind='stable')[:2].tolist())
    return first, second


def _path(name: str, T_world_camera: FloatArray, axes: tuple[int, int]) -> Plot:
    keep = slice(None, None, _step(len(T_world_camera)))
    x, y = (T_world_camera[keep, k, 3] for k in axes)
    return _line(name, _floats(x), _floats(y), mode='lines')


def _step(n: int) -> int:
    return max(1, n // _MAX_POINTS)


def _floats(values: NDArray[np.generic]) -> list[float]:
    return [round(float(v), 4) for v in values]
