"""The picture of `hoid demo`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D

from hoid_common.values import NS_PER_S, ByteArray, FloatArray, IntArray, ObjectState
from hoid_filter.drawing import KEPT_BGR, REASON_BGR, REMOVED_BGR, Bgr

_SIZE_IN, _DPI = (12.0, 10.5), 100
_HEIGHTS = (3.3, 4.6, 2.3)
_TRUTH, _PATH, _MAP = '#111111', '#d1495b', '#8fa3b8'
_COLORS = ('#d1495b', '#c27b13', '#2563a8')
_LEAST_SHOWN_M = 0.0005
_SHOWN_M = (0.15, 2.3)  # heights of the points drawn in the floor plan
_PLAN_X_M, _PLAN_Y_M = (-0.5, 7.0), (-0.5, 6.2)
_SHOWN_ABOUT_CAMERA_M = (-1.0, 1.0)  # the same if the first camera is the origin


class Snapshot(NamedTuple):
    """An image with the decisions of the filter drawn into it."""

    stamp_ns: int
    image_bgr: ByteArray  # (H, W, 3)
    points_camera_m: FloatArray  # (N, 3) the features that were kept and have depth


class DemoRun(NamedTuple):
    """Trajectory and points of a run, in the frame of the ground truth if it is known."""

    stamps_ns: IntArray  # (N,)
    T_world_camera: FloatArray  # (N, 4, 4)
    points_world_m: FloatArray  # (M, 3) features where the poses of the run place them
    T_world_camera_true: FloatArray | None = None  # (N, 4, 4)
    error_m: FloatArray | None = None  # (N,) distance to the ground truth


def draw_demo(path: Path, runs: Mapping[str, DemoRun], shown: Sequence[Snapshot]) -> None:
    """Write frames, floor plans and errors of runs of one recording as PNG."""
    figure = Figure(figsize=_SIZE_IN, dpi=_DPI, layout='constrained')
    FigureCanvasAgg(figure)
    parts = figure.subfigures(3, 1, squeeze=False, height_ratios=_HEIGHTS)
    top, middle, bottom = parts[:, 0]
    _draw_snapshots(top, shown)
    plans = middle.subplots(1, len(runs), sharex=True, sharey=True)
    for axes, (label, run) in zip(plans, runs.items(), strict=True):
        _draw_plan(axes, label, run)
        axes.label_outer()
    handles, labels = plans[-1].get_legend_handles_labels()
    middle.legend(
        handles,
        labels,
        loc='outside lower center',
        ncols=len(labels),
        frameon=False,
        markerscale=5,
    )
    _draw_errors(bottom.subplots(), runs)
    figure.savefig(path, format='png', metadata={'Software': None})


def _draw_snapshots(figure: SubFigure, shown: Sequence[Snapshot]) -> None:
    for axes, snapshot in zip(figure.subplots(1, len(shown)), shown, strict=True):
        axes.imshow(snapshot.image_bgr[..., ::-1])
        axes.set_axis_off()
    words = {
        'person': REASON_BGR[ObjectState.PERSON],
        'handled object': REASON_BGR[ObjectState.HANDLED],
    }
    marks = {'feature kept': KEPT_BGR, 'feature removed': REMOVED_BGR}
    handles = [Line2D([], [], color=_rgb(c), lw=3, label=word) for word, c in words.items()]
    handles += [
        Line2D([], [], color=_rgb(c), marker='o', ls='', mfc='none', label=word)
        for word, c in marks.items()
    ]
    figure.legend(handles=handles, loc='outside lower center', ncols=len(handles), frameon=False)


def _draw_plan(axes: Axes, label: str, run: DemoRun) -> None:
    """Draw the points and the trajectory of the camera seen from above."""
    height = run.points_world_m[:, 2]
    lowest, highest = _SHOWN_M if run.error_m is not None else _SHOWN_ABOUT_CAMERA_M
    shown = run.points_world_m[(height > lowest) & (height < highest)]
    axes.plot(
        *shown[:, :2].T, '.', color=_MAP, ms=1.2, label='features used, where the run places them'
    )
    axes.plot(
        *run.T_world_camera[:, :2, 3].T, color=_PATH, lw=1.8, zorder=4, label='camera, estimated'
    )
    if run.T_world_camera_true is None or run.error_m is None:
        axes.set_title(label, loc='left', fontsize=11)
    else:
        axes.plot(
            *run.T_world_camera_true[:, :2, 3].T,
            color=_TRUTH,
            lw=3.0,
            label='camera, ground truth',
        )
        rmse_m = float(np.sqrt(np.mean(run.error_m**2)))
        axes.set_title(f'{label}: ATE RMSE {rmse_m:.4f} m', loc='left', fontsize=11)
        axes.set(xlim=_PLAN_X_M, ylim=_PLAN_Y_M)
    axes.set(xlabel='x [m]', ylabel='y [m]', aspect='equal')


def _draw_errors(axes: Axes, runs: Mapping[str, DemoRun]) -> None:
    """Draw the errors, or without ground truth the distance of the others from the last run."""
    for color, (label, stamps_ns, error_m) in zip(_COLORS, _errors(runs), strict=False):
        since_s = (stamps_ns - stamps_ns[0]) / NS_PER_S
        axes.plot(since_s, error_m, color=color, lw=1.8, label=label)
    what = 'error' if all(run.error_m is not None for run in runs.values()) else 'distance'
    axes.set(xlabel='time [s]', ylabel=f'{what} [m]', yscale='log', ylim=(_LEAST_SHOWN_M, None))
    axes.legend(loc='lower left', bbox_to_anchor=(0, 1), ncols=len(runs), frameon=False)
    axes.grid(visible=True, color='#e3e5e8', lw=0.7)


def _errors(runs: Mapping[str, DemoRun]) -> Iterator[tuple[str, IntArray, FloatArray]]:
    if all(run.error_m is not None for run in runs.values()):
        yield from ((label, r.stamps_ns, r.error_m) for label, r in runs.items())  # type: ignore[misc]
        return
    *others, (last_label, last) = runs.items()
    for label, run in others:
        stamps_ns, of_run, of_last = np.intersect1d(
            run.stamps_ns, last.stamps_ns, return_indices=True
        )
        apart_m = run.T_world_camera[of_run, :3, 3] - last.T_world_camera[of_last, :3, 3]
        yield f'{label}, from {last_label}', stamps_ns, np.linalg.norm(apart_m, axis=1)


def _rgb(color: Bgr) -> tuple[float, float, float]:
    b, g, r = color
    return r / 255, g / 255, b / 255
