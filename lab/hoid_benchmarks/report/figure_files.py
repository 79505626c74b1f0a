"""Figures as PNG and SVG files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

mpl.use('Agg')
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from hoid_benchmarks.plan.plan import Experiment
from hoid_benchmarks.report.figures import TRUTH, Plot

_COLORS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7', '#e69f00', '#56b4e9', '#8c6bb1', '#7f7f7f')
_SIZE_INCH = (6.4, 4.0)
_DPI = 150
_DATES = {'.png': {}, '.svg': {'Date': None}}  # without a date, equal results give equal files


def save_figures(experiment: Experiment, plots: Sequence[Plot], folder: Path) -> list[Path]:
    """Write each plot as PNG and SVG and return their paths."""
    return [
        path
        for i, plot in enumerate(plots)
        for path in _save(plot, folder / f'{experiment.id}-{i}')
    ]


def _save(plot: Plot, stem: Path) -> list[Path]:
    with plt.rc_context({'svg.hashsalt': 'hoid', 'font.size': 9, 'axes.titlesize': 10}):
        figure, axes = plt.subplots(figsize=_SIZE_INCH, layout='constrained')
        _draw(plot, axes)
        paths = [stem.with_name(stem.name + suffix) for suffix in _DATES]
        for path in paths:
            figure.savefig(path, dpi=_DPI, metadata=_DATES[path.suffix])
        plt.close(figure)
    return paths


def _draw(plot: Plot, axes: Axes) -> None:
    estimates = [trace for trace in plot['data'] if trace['name'] != TRUTH]
    for trace in plot['data']:
        if trace['name'] == TRUTH:
            axes.plot(trace['x'], trace['y'], 'k:', lw=2.2, label=TRUTH)
            continue
        color = _COLORS[estimates.index(trace) % len(_COLORS)]
        marker = '' if trace['mode'] == 'lines' else '.'
        axes.plot(trace['x'], trace['y'], marker=marker, lw=1.2, color=color, label=trace['name'])
    layout = plot['layout']
    axes.set(
        title=layout['title']['text'],
        xlabel=layout['xaxis']['title']['text'],
        ylabel=layout['yaxis']['title']['text'],
        xscale=layout['xaxis'].get('type', 'linear'),
    )
    if layout['yaxis'].get('scaleanchor'):
        axes.set_aspect('equal', adjustable='datalim')
    else:
        axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.spines[['top', 'right']].set_visible(False)
    axes.legend(frameon=False)
