"""Plots of a trajectory from above and from the side, and of its errors over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from hoid_bringup.evaluate.evaluation import AlignedTrajectory
from hoid_common.values import NS_PER_S, FloatArray, IntArray, Trajectory

_GAP_S = 0.25  # chosen: a longer time without a pose is drawn as a gap
_TRUTH = '#b4b9c2'
_PATH = '#2563a8'
_ERROR_MAP = 'plasma'
_SIZE_IN = (12.0, 8.2)
_DPI = 110
_MIN_SPAN_M = 0.05  # chosen: least half width of a plot, so that noise at rest is not magnified


def plot_run(
    path: Path, estimate: Trajectory, aligned: AlignedTrajectory | None, title: str
) -> None:
    """Write a PNG with the trajectory of a run, and its errors or its speed over time.

    Args:
        estimate: All poses of the run in the map frame (z up); drawn if `aligned` is None.
        aligned: The poses aligned to the ground truth; None if there is no ground truth.
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


def _draw_errors(
    figure: Figure, above: Axes, side: Axes, bottom: Axes, aligned: AlignedTrajectory
) -> None:
    """Draw the estimate, colored by error, over the ground truth, and the error over time."""
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
    """Draw ground truth and estimate in a plane of two axes; return the line of the estimate."""
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
    """Draw a trajectory without ground truth, and below it its speed, which shows jumps."""
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
    """Return (N-1,) factors for the line segments between poses: 1, or NaN at a gap."""
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
    """Draw a line through (N, 2) points, in one color or colored by (N,) values, and return it.

    `joined` (N-1,) is the result of `_joined`: NaN removes a line segment.
    """
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
    """Set the limits of the axes to show all (N, 2) points at equal scale with a margin."""
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
