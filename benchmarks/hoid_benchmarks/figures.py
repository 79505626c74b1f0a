"""Figures of the experiments: interactive ones for the page, PNG and SVG for papers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use('Agg')
import matplotlib.pyplot as plt

from hoid_bags.trajectory_io import read_tum
from hoid_benchmarks.plan import Experiment
from hoid_benchmarks.results import Result, key_value, result_path, spread
from hoid_benchmarks.tables import setting_of
from hoid_bringup.evaluation import AlignedTrajectory, align

Plot = dict[str, Any]  # a plotly figure: data and layout
_VALUES = {
    'curve': (('ate_rmse_m', 'ATE RMSE [m]'), ('coverage', 'coverage')),
    'cost': (('stage_ms.frame.median', 'time per frame [ms]'), ('peak_rss_mb', 'memory [MB]')),
}
_MAX_POINTS = 1500  # of a drawn trajectory; keeps the page small


def make_plots(
    experiment: Experiment, results: Sequence[Result], folder: Path
) -> tuple[Plot, ...]:
    """Return the interactive plots of an experiment; runs whose files are gone are left out."""
    if experiment.view in _VALUES:
        return tuple(
            _curve_plot(experiment, results, name, label)
            for name, label in _VALUES[experiment.view]
        )
    if experiment.view == 'comparison':
        return tuple(
            plot
            for sequence in dict.fromkeys(r.job.sequence for r in results)
            for plot in _trajectory_plots(sequence, _first_runs(results, sequence), folder)
        )
    return ()


def save_figures(experiment: Experiment, plots: Sequence[Plot], folder: Path) -> list[Path]:
    """Write each plot as PNG and SVG and return their paths."""
    paths = []
    for i, plot in enumerate(plots):
        figure, axes = plt.subplots(figsize=(7, 4.2), layout='constrained')
        for trace in plot['data']:
            axes.plot(trace['x'], trace['y'], marker='.', ms=3, lw=1, label=trace['name'])
        layout = plot['layout']
        axes.set(
            title=layout['title']['text'],
            xlabel=layout['xaxis']['title']['text'],
            ylabel=layout['yaxis']['title']['text'],
            yscale=layout['yaxis'].get('type', 'linear'),
        )
        if layout['yaxis'].get('scaleanchor'):
            axes.set_aspect('equal')
        axes.legend(fontsize=7)
        axes.grid(alpha=0.3)
        for suffix in ('.png', '.svg'):
            paths.append(folder / f'{experiment.id}-{i}{suffix}')
            figure.savefig(paths[-1], dpi=150, metadata={'Date': None} if suffix == '.svg' else {})
        plt.close(figure)
    return paths


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
    return _plot(
        f'{experiment.title}: {label}', experiment.varied, label, data, rangemode='tozero'
    )


def _first_runs(results: Sequence[Result], sequence: str) -> list[Result]:
    runs: dict[tuple[str, str], Result] = {}
    for r in results:
        if r.ok and r.job.sequence == sequence:
            runs.setdefault((r.job.filter, r.job.detector), r)
    return list(runs.values())


def _trajectory_plots(sequence: str, runs: Sequence[Result], folder: Path) -> list[Plot]:
    """Draw the paper's Figures 8 and 9: trajectories and their error over time, by filter."""
    above: list[Plot] = []
    error: list[Plot] = []
    for r in runs:
        run = result_path(folder, r.job).parent
        if not (run / 'ground_truth.txt').is_file():
            continue
        aligned = align(read_tum(run / 'trajectory.txt'), read_tum(run / 'ground_truth.txt'))
        name = ' '.join(filter(None, (r.job.filter, r.job.detector)))
        if not above:
            above.append(_path('ground truth', aligned, aligned.T_world_camera_true))
        above.append(_path(name, aligned, aligned.T_world_camera))
        seconds = (aligned.stamps_ns - aligned.stamps_ns[0]) * 1e-9
        keep = _thinned(len(seconds))
        error.append(_line(name, _floats(seconds[keep]), _floats(aligned.error_m[keep])))
    if not above:
        return []
    return [
        _plot(f'{sequence}: trajectories from above', 'x [m]', 'y [m]', above, scaleanchor='x'),
        _plot(f'{sequence}: error over time', 'time [s]', 'error [m]', error, rangemode='tozero'),
    ]


def _path(name: str, aligned: AlignedTrajectory, T_world_camera: np.ndarray) -> Plot:
    keep = _thinned(len(aligned.stamps_ns))
    x, y = T_world_camera[keep, 0, 3], T_world_camera[keep, 1, 3]
    return _line(name, _floats(x), _floats(y), mode='lines')


def _thinned(n: int) -> slice:
    return slice(None, None, max(1, n // _MAX_POINTS))


def _floats(values: np.ndarray) -> list[float]:
    return [round(float(v), 4) for v in values]
