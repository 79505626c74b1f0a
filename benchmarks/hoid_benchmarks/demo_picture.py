"""The picture and the animation of `hoid demo`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from PIL import Image

from hoid_bringup.evaluate.evaluation import AlignedTrajectory
from hoid_common import se3
from hoid_common.values import NS_PER_S, ByteArray, FloatArray, Reason
from hoid_filter.drawing import KEPT_BGR, REASON_BGR, REMOVED_BGR, Bgr

_SIZE_IN, _DPI = (12.0, 11.0), 100
_HEIGHTS = (3.2, 5.0, 2.2)
_TRUTH, _PATH, _MAP = '#111111', '#d1495b', '#8fa3b8'
_COLORS = ('#d1495b', '#2563a8')
_LEAST_SHOWN_CM = 0.05
_FLOOR_M, _CEILING_M = 0.15, 2.3  # between which map points show in the plan
_ANIMATED_MS = 130
_PALETTE = 48  # colours of the animation


class Snapshot(NamedTuple):
    """An image with what the filter decided drawn into it."""

    stamp_ns: int
    image_bgr: ByteArray  # (H, W, 3)


class DemoRun(NamedTuple):
    """What a replay leaves."""

    path: AlignedTrajectory
    points_map_m: FloatArray  # (N, 3), of the sparse map


def draw_demo(path: Path, runs: Mapping[str, DemoRun], shown: Sequence[Snapshot]) -> None:
    """Write frames, floor plans and errors of two runs of one recording as PNG."""
    figure = Figure(figsize=_SIZE_IN, dpi=_DPI, layout='constrained')
    FigureCanvasAgg(figure)
    parts = figure.subfigures(3, 1, squeeze=False, height_ratios=_HEIGHTS)
    top, middle, bottom = parts[:, 0]
    _draw_snapshots(top, shown)
    plans = middle.subplots(1, len(runs), sharex=True, sharey=True)
    for axes, (label, run) in zip(plans, runs.items(), strict=True):
        _draw_plan(axes, label, run)
    _draw_errors(bottom.subplots(), runs)
    figure.savefig(path, format='png', metadata={'Software': None})


def write_animation(path: Path, images_bgr: Sequence[ByteArray]) -> None:
    """Write images (H, W, 3) as a GIF that repeats."""
    frames = [Image.fromarray(image[..., ::-1]).quantize(_PALETTE) for image in images_bgr]
    frames[0].save(
        path, save_all=True, append_images=frames[1:], duration=_ANIMATED_MS, loop=0, optimize=True
    )


def _draw_snapshots(figure: SubFigure, shown: Sequence[Snapshot]) -> None:
    for axes, snapshot in zip(figure.subplots(1, len(shown)), shown, strict=True):
        axes.imshow(snapshot.image_bgr[..., ::-1])
        axes.set_axis_off()
    words = {
        'person': REASON_BGR[Reason.PERSON],
        'handled object': REASON_BGR[Reason.HANDLED],
    }
    marks = {'feature kept': KEPT_BGR, 'feature removed': REMOVED_BGR}
    handles = [Line2D([], [], color=_rgb(c), lw=3, label=word) for word, c in words.items()]
    handles += [
        Line2D([], [], color=_rgb(c), marker='o', ls='', mfc='none', label=word)
        for word, c in marks.items()
    ]
    figure.legend(handles=handles, loc='outside lower center', ncols=len(handles), frameon=False)


def _draw_plan(axes: Axes, label: str, run: DemoRun) -> None:
    """Draw map points and path from above, in the frame of the truth."""
    points_m = se3.transform(run.path.T_world_map, run.points_map_m)
    height = points_m[:, 2]
    shown = points_m[(height > _FLOOR_M) & (height < _CEILING_M)]
    axes.plot(*shown[:, :2].T, '.', color=_MAP, ms=1.5, label='map points')
    true_m, found_m = run.path.T_world_camera_true[:, :2, 3], run.path.T_world_camera[:, :2, 3]
    axes.plot(*found_m.T, color=_PATH, lw=1.8, zorder=4, label='camera, estimated')
    axes.plot(*true_m.T, color=_TRUTH, lw=3.0, label='camera, truth')
    rmse_cm = 100 * float(np.sqrt(np.mean(run.path.error_m**2)))
    axes.set_title(f'{label}: {rmse_cm:.1f} cm RMSE', loc='left', fontsize=11)
    axes.set(xlabel='x [m]', ylabel='y [m]', aspect='equal', xlim=(-0.5, 7.0), ylim=(-0.5, 6.2))
    axes.legend(loc='upper right', fontsize=8, markerscale=5)


def _draw_errors(axes: Axes, runs: Mapping[str, DemoRun]) -> None:
    for color, (label, run) in zip(_COLORS, runs.items(), strict=True):
        since_s = (run.path.stamps_ns - run.path.stamps_ns[0]) / NS_PER_S
        axes.plot(since_s, 100 * run.path.error_m, color=color, lw=1.8, label=label)
    axes.set(xlabel='time [s]', ylabel='error [cm]', yscale='log', ylim=(_LEAST_SHOWN_CM, None))
    axes.legend(
        loc='lower left', bbox_to_anchor=(0, 1), ncols=len(runs), fontsize=9, frameon=False
    )
    axes.grid(visible=True, color='#e3e5e8', lw=0.7)


def _rgb(color: Bgr) -> tuple[float, float, float]:
    b, g, r = color
    return r / 255, g / 255, b / 255
