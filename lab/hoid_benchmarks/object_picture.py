"""The picture of an object map: its boxes in an image, and from above."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from hoid_benchmarks.markdown import markdown_table
from hoid_benchmarks.objects.image_boxes import draw_box
from hoid_benchmarks.rooms.room_run import MappedRoom, ObjectHistory
from hoid_common import se3
from hoid_common.values import CameraModel, FloatArray, RgbdFrame
from hoid_scene.objects.mapped_object import MapObject

_SIZE_IN, _DPI, _QUALITY = (13.0, 5.4), 100, 88
_CLOUD = '#8fa3b8'
_COLORS = (
    '#d1495b', '#2563a8', '#2a9d4a', '#c27b13', '#7b3fa0', '#00838f', '#8d5524', '#e0559b',
)  # fmt: skip
# Corners around a box, as seen from above, as shares of its size.
_CORNERS = np.array([(-0.5, -0.5, 0), (-0.5, 0.5, 0), (0.5, 0.5, 0), (0.5, -0.5, 0)])

_HEADER = ('id', 'class', 'sightings', 'size m', 'jitter cm', 'in the second half cm')


class ObjectRow(NamedTuple):
    """An object of the map, and how much its published center moved."""

    item: MapObject
    # Root mean square distance of the center from its median: over all looks, in which the seen
    # part grows, and over the second half of them.
    jitter_m: float
    late_jitter_m: float


def object_rows(objects: Sequence[MapObject], history: ObjectHistory) -> list[ObjectRow]:
    """Return the objects at rest with the jitter of their centers."""
    out = []
    for item in objects:
        at = [o for looked in history.values() for o in looked if o.object_id == item.object_id]
        centers_m = np.array([o.center_map_m for o in at if o.state is item.state])
        if item.is_present and len(centers_m):
            late_m = centers_m[len(centers_m) // 2 :]
            out.append(ObjectRow(item, _deviation_m(centers_m), _deviation_m(late_m)))
    return out


def _deviation_m(centers_m: FloatArray) -> float:
    gaps_m = np.linalg.norm(centers_m - np.median(centers_m, axis=0), axis=1)
    return float(np.sqrt(np.mean(gaps_m**2)))


def object_table(rows: Sequence[ObjectRow]) -> str:
    """Return a Markdown table of objects."""
    lines = []
    for item, *jitter_m in rows:
        size = ' x '.join(f'{side_m:.2f}' for side_m in item.size_m)
        names = str(item.object_id), item.class_name, str(item.num_sightings), size
        lines.append((*names, *(f'{100 * each_m:.1f}' for each_m in jitter_m)))
    return markdown_table(_HEADER, lines)


def draw_objects(path: Path, room: MappedRoom, frame: RgbdFrame, camera: CameraModel) -> None:
    """Write a JPEG with the objects at rest: in an image, and from above with the dense map.

    Args:
        path: The file.
        room: The maps at the end.
        frame: The image; its pose is the final one.
        camera: The camera of the image.
    """
    figure = Figure(figsize=_SIZE_IN, dpi=_DPI, layout='constrained')
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    shown = [item for item in room.objects if item.is_present]
    row = int(np.searchsorted(room.trajectory.stamps_ns, frame.stamp_ns))
    T_map_camera = room.trajectory.T_world_camera[min(row, len(room.trajectory) - 1)]
    image_bgr = frame.image_bgr.copy()
    for item, color in zip(shown, cycle(_COLORS)):
        rgb = np.multiply(to_rgb(color), 255).astype(int).tolist()
        draw_box(image_bgr, item, T_map_camera, camera, rgb[::-1])
        _draw_from_above(right, item, color)
    left.imshow(image_bgr[..., ::-1])
    left.set_axis_off()
    points_m = room.cloud.points_m
    right.plot(*points_m[:, :2].T, '.', color=_CLOUD, ms=0.6)
    right.set(xlabel='x [m]', ylabel='y [m]', aspect='equal')
    figure.savefig(path, format='jpeg', pil_kwargs={'quality': _QUALITY})


def _draw_from_above(axes: Axes, item: MapObject, color: str) -> None:
    floor = se3.transform(item.T_map_object, _CORNERS * item.size_m)[:, :2]
    axes.fill(*floor.T, facecolor=color, edgecolor=color, alpha=0.45, lw=1.4)
    box = {'facecolor': 'white', 'edgecolor': 'none', 'alpha': 0.7, 'pad': 0.6}
    text = f'{item.object_id} {item.class_name}'
    axes.text(
        floor[:, 0].max(), floor[:, 1].max(), text, color=color, fontsize=8, bbox=box, clip_on=True
    )
