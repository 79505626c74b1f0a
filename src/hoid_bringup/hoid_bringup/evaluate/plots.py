"""Pictures of runs: the path from above, from the side, and its error over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure, FigureBase
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FormatStrFormatter, NullFormatter

from hoid_bringup.evaluate.evaluation import AlignedTrajectory
from hoid_common.values import NS_PER_S, ByteArray, FloatArray, IntArray, Trajectory

_GAP_S = 0.25  # a longer silence is drawn as a break in the line
_TRUTH = '#b4b9c2'
_PATH = '#2563a8'
_COLORS = ('#2563a8', '#c8553d', '#3c8d5a', '#8a6db1')
_ERROR_MAP = 'plasma'
_SIZE_IN = (12.0, 8.2)
_DPI = 110
_MIN_SPAN_M = 0.05
_PAD_IN = 0.12
_STRIP_IN, _PATHS_IN = 2.4, 6.6  # heights of a row of thumbnails and of what is below
_LEAST_SHOWN_CM = 0.1  # of a logarithmic axis


def plot_run(
    path: Path, estimate: Trajectory, aligned: AlignedTrajectory | None, title: str
) -> None:
    """Write a picture of a run as PNG.

    Args:
        path: The file, replaced when it is there.
        estimate: All poses of the run in the map frame (z up), drawn when there is no truth.
        aligned: The same moved onto the ground truth, or None without one.
        title: What was run, in one line.
    """
    figure = Figure(figsize=_SIZE_IN, dpi=_DPI, layout='constrained')
    FigureCanvasAgg(figure)
    rows = figure.add_gridspec(2, 2, height_ratios=(2.6, 1.0))
    above, side = figure.add_subplot(rows[0, 0]), figure.add_subplot(rows[0, 1])
    bottom = figure.add_subplot(rows[1, :])
    if aligned is None:
        _draw_estimate(above, side, bottom, estimate)
    else:
        _draw_errors(figure, above, side, bottom, aligned)
    _label(above, 'from above', 'x [m]', 'y [m]')
    _label(side, 'from the side', 'x [m]', 'z [m]')
    figure.suptitle(title, fontsize=12, fontweight='bold')
    figure.savefig(path, format='png', metadata={'Software': None})


def plot_comparison(
    path: Path,
    runs: Mapping[str, AlignedTrajectory],
    title: str,
    thumbnails: Sequence[ByteArray] = (),
) -> None:
    """Write a picture of several runs of one recording side by side, at one scale of error.

    Args:
        path: The file, replaced when it is there.
        runs: By label.
        title: What was run, in one line.
        thumbnails: (H, W, 3) BGR pictures for a row above.
    """
    height_in = _PATHS_IN + (_STRIP_IN if thumbnails else 0.0)
    figure = Figure(figsize=(_SIZE_IN[0], height_in), dpi=_DPI, layout='constrained')
    FigureCanvasAgg(figure)
    engine = cast('ConstrainedLayoutEngine', figure.get_layout_engine())
    engine.set(w_pad=_PAD_IN)
    figure.suptitle(title, fontsize=12, fontweight='bold')
    below = _below_thumbnails(figure, thumbnails) if thumbnails else figure
    rows = below.add_gridspec(2, len(runs), height_ratios=(2.2, 1.0))
    _draw_paths(below, [below.add_subplot(rows[0, i]) for i in range(len(runs))], runs)
    _draw_error_curves(below.add_subplot(rows[1, :]), runs)
    figure.savefig(path, format='png', metadata={'Software': None})


def _below_thumbnails(figure: Figure, thumbnails: Sequence[ByteArray]) -> FigureBase:
    """Draw a row of BGR pictures and return what is left of the figure below it."""
    parts = figure.subfigures(2, 1, squeeze=False, height_ratios=(_STRIP_IN, _PATHS_IN))
    strip, below = parts[:, 0]
    for i, image_bgr in enumerate(thumbnails):
        axes = strip.add_subplot(1, len(thumbnails), i + 1)
        axes.imshow(image_bgr[..., ::-1])
        axes.set_axis_off()
    return cast('FigureBase', below)


def _draw_paths(
    figure: FigureBase, above: Sequence[Axes], runs: Mapping[str, AlignedTrajectory]
) -> None:
    """Draw each run's path from above, at one scale of error."""
    worst_cm = max(100 * float(np.percentile(run.error_m, 99)) for run in runs.values())
    norm = Normalize(0.0, max(worst_cm, 1e-3))
    for axes, (label, run) in zip(above, runs.items(), strict=True):
        lines = _draw_plane(axes, run, (0, 1), norm)
        rmse_cm = 100 * float(np.sqrt(np.mean(run.error_m**2)))
        _label(axes, f'{label}: ATE RMSE {rmse_cm:.2f} cm', 'x [m]', 'y [m]')
    figure.colorbar(lines, ax=list(above), label='error [cm]', extend='max', shrink=0.9)


def _draw_error_curves(axes: Axes, runs: Mapping[str, AlignedTrajectory]) -> None:
    """Draw the runs' errors over time, on a logarithmic axis."""
    for (label, run), color in zip(runs.items(), cycle(_COLORS), strict=False):
        stamps_s = (run.stamps_ns - run.stamps_ns[0]) / NS_PER_S
        axes.plot(stamps_s, 100 * run.error_m, color=color, lw=1.8, label=label)
    axes.set(yscale='log', ylim=(_LEAST_SHOWN_CM, None))
    axes.yaxis.set_major_formatter(FormatStrFormatter('%g'))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.legend(loc='upper right', fontsize=9)
    _label(axes, '', 'time [s]', 'error [cm]')


def _draw_errors(
    figure: Figure, above: Axes, side: Axes, bottom: Axes, aligned: AlignedTrajectory
) -> None:
    """Draw the estimate coloured by its distance from the truth, over the truth in grey."""
    error_cm = 100 * aligned.error_m
    norm = Normalize(0.0, max(float(np.percentile(error_cm, 99)), 1e-3))
    joined = _joined(aligned.stamps_ns)
    _draw_plane(above, aligned, (0, 1), norm)
    lines = _draw_plane(side, aligned, (0, 2), norm)
    figure.colorbar(lines, ax=[above, side], label='error [cm]', extend='max', shrink=0.9)
    stamps_s = (aligned.stamps_ns - aligned.stamps_ns[0]) / NS_PER_S
    _path(bottom, np.stack([stamps_s, error_cm], axis=1), joined, values=error_cm, norm=norm)
    rmse_cm = float(np.sqrt(np.mean(error_cm**2)))
    bottom.axhline(rmse_cm, color=_TRUTH, ls='--', lw=1.3, label=f'RMSE {rmse_cm:.2f} cm')
    bottom.legend(loc='upper right', fontsize=9)
    bottom.set(xlim=(0, max(stamps_s[-1], 0.1)), ylim=(0, 1.08 * max(error_cm.max(), 1e-3)))
    _label(bottom, '', 'time [s]', 'error [cm]')


def _draw_plane(
    axes: Axes, aligned: AlignedTrajectory, plane: tuple[int, int], norm: Normalize
) -> LineCollection:
    """Draw truth and estimate in a plane of two coordinates; return the coloured stroke."""
    xyz_m = aligned.T_world_camera[:, :3, 3]
    true_m = aligned.T_world_camera_true[:, :3, 3]
    joined = _joined(aligned.stamps_ns)
    _path(axes, true_m[:, plane], joined, color=_TRUTH, width=3.2, label='ground truth')
    lines = _path(axes, xyz_m[:, plane], joined, values=100 * aligned.error_m, norm=norm)
    axes.plot(*xyz_m[0, plane], 'o', color='black', ms=5, zorder=4, label='start')
    _fit(axes, np.concatenate([xyz_m, true_m])[:, plane])
    axes.legend(loc='best', fontsize=9, framealpha=0.9)
    return lines


def _draw_estimate(above: Axes, side: Axes, bottom: Axes, estimate: Trajectory) -> None:
    """Draw a path without truth; below it the speed, in which jumps show."""
    _label(bottom, '', 'time [s]', 'speed [m/s]')
    if len(estimate) < 2:
        above.text(0.5, 0.5, 'no trajectory', ha='center', transform=above.transAxes)
        return
    xyz_m = estimate.T_world_camera[:, :3, 3]
    joined = _joined(estimate.stamps_ns)
    for axes, plane in ((above, (0, 1)), (side, (0, 2))):
        _path(axes, xyz_m[:, plane], joined, color=_PATH, width=1.8, label='estimate')
        axes.plot(*xyz_m[0, plane], 'o', color='black', ms=5, zorder=4, label='start')
        _fit(axes, xyz_m[:, plane])
    above.legend(loc='best', fontsize=9, framealpha=0.9)
    stamps_s = (estimate.stamps_ns - estimate.stamps_ns[0]) / NS_PER_S
    speed = np.linalg.norm(np.diff(xyz_m, axis=0), axis=1) / np.diff(stamps_s)
    points = np.stack([stamps_s[1:], speed], axis=1)
    _path(bottom, points, joined[1:], color=_PATH, width=1.2, label='speed')
    bottom.set(xlim=(0, stamps_s[-1]), ylim=(0, 1.08 * max(speed.max(), 1e-3)))


def _joined(stamps_ns: IntArray) -> FloatArray:
    """Return (N-1,) 1 where consecutive poses belong to one stroke, NaN over a gap."""
    return np.where(np.diff(stamps_ns) <= _GAP_S * NS_PER_S, 1.0, np.nan)


def _path(
    axes: Axes,
    points: FloatArray,
    joined: FloatArray,
    *,
    color: str | None = None,
    width: float = 2.0,
    label: str | None = None,
    values: FloatArray | None = None,
    norm: Normalize | None = None,
) -> LineCollection:
    """Add the (N, 2) points as one stroke, of one colour or coloured by (N,) values."""
    segments = np.stack([points[:-1], points[1:]], axis=1) * joined[:, None, None]
    lines = LineCollection(list(segments), linewidths=width, capstyle='round', label=label)
    if values is None:
        lines.set_color(color or _PATH)
    else:
        lines.set(cmap=_ERROR_MAP, norm=norm)
        lines.set_array(0.5 * (values[:-1] + values[1:]))
        lines.set_zorder(3)
    axes.add_collection(lines)
    return lines


def _fit(axes: Axes, points: FloatArray) -> None:
    """Show all (N, 2) points at equal scale, with room around them."""
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    axes.update_datalim([*points, center - _MIN_SPAN_M, center + _MIN_SPAN_M])
    axes.margins(0.06)
    axes.autoscale_view()
    axes.set_aspect('equal', adjustable='datalim')


def _label(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set(xlabel=x, ylabel=y)
    axes.set_title(title, fontsize=11, loc='left')
    axes.grid(visible=True, color='#e3e5e8', lw=0.7)
    axes.set_axisbelow(True)
    axes.spines[['top', 'right']].set_visible(False)
