"""Motion segmentation of two real images: shares of moving pixels found and static ones lost."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from hoid_bags.images import decode_color, decode_depth, read_image_bytes
from hoid_benchmarks.markdown import markdown_table
from hoid_benchmarks.plan.sequences import Store
from hoid_common.errors import InputError
from hoid_common.io.images import depth_m_from_units
from hoid_common.io.yaml_file import read_yaml
from hoid_common.values import BoolArray, CameraModel
from hoid_filter.config import ExtractionConfig, MotionConfig
from hoid_filter.extraction.extractor import OrbExtractor
from hoid_filter.motion.downscaled_camera import MotionView
from hoid_filter.motion.motion_segmentation import MotionDetector

_OUTLINES = Path(__file__).with_name('pairs.yaml')
_CAMERA = CameraModel(640, 480, 527.0, 533.0, 319.5, 239.5)
_DEPTH_UNITS_PER_M = 5000.0
_EDGE_PX = 4  # pixels this near to an outline are not counted, because outlines are rough


class Presentation(NamedTuple):
    """Order and period in which the two images of a pair are presented."""

    label: str
    order: tuple[int, ...]
    period_s: float


PRESENTATIONS = (
    Presentation('once, 33 ms apart', (0, 1), 1 / 30),
    Presentation('once, 100 ms apart', (0, 1), 0.1),
    Presentation('to and fro, 10 images at 30 Hz', (0, 1) * 5, 1 / 30),
)


def pair_report(only: Sequence[str], store: Store) -> str:
    """Return a table of the shares found and lost, for the named pairs or for all.

    Raises:
        InputError: A pair is unknown or missing.
    """
    outlines = read_yaml(_OUTLINES)
    if unknown := set(only) - set(outlines):
        raise InputError(f'no pair {min(unknown)}: {", ".join(outlines)}')
    header = ['pair', *(f'{each.label}: found / lost' for each in PRESENTATIONS)]
    rows = []
    for name in only or outlines:
        folder = store.shared / 'data' / 'movers' / name
        shares = [evaluate_pair(folder, outlines[name], each) for each in PRESENTATIONS]
        cells = (f'{found:.2f} / {lost:.2f}' for found, lost in shares)
        rows.append((name.replace('_', ' '), *cells))
    return markdown_table(header, rows)


def evaluate_pair(
    folder: Path, outlines: Sequence[Sequence[int]], presentation: Presentation
) -> tuple[float, float]:
    """Return the share of moving pixels with depth that is found, and of static ones lost.

    Args:
        folder: Folder with `color0.png`, `depth0.png`, `color1.png` and `depth1.png`.
        outlines: Outlines of moving objects in the second image, as x, y, x, y, ... in px.
        presentation: Order and period of the images; the second image is the last one.
    """
    views = [_view(folder, k) for k in (0, 1)]
    motion = MotionDetector(MotionConfig())
    for i, k in enumerate(presentation.order):
        motion.detect(views[k]._replace(stamp_ns=round(i * presentation.period_s * 1e9)))
    last = views[1].depth_m
    everywhere = np.arange(last.size)
    found = (
        motion.regions_at(round(len(presentation.order) * 1e9))
        .label_at(everywhere)
        .reshape(last.shape)
        > 0
    )
    moving, resting = (part & (last > 0) for part in _parts(outlines))
    return float(found[moving].mean()), float(found[resting].mean())


def _view(folder: Path, k: int) -> MotionView:
    color, depth = folder / f'color{k}.png', folder / f'depth{k}.png'
    image_bgr = decode_color(read_image_bytes(color), color)
    gray = np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)
    units = decode_depth(read_image_bytes(depth), depth)
    corners = OrbExtractor(ExtractionConfig()).detect(gray)
    depth_m = depth_m_from_units(units, _DEPTH_UNITS_PER_M)
    return MotionView(0, _CAMERA, gray, depth_m, corners.pixel, corners.score)


def _parts(outlines: Sequence[Sequence[int]]) -> tuple[BoolArray, BoolArray]:
    """Return (H, W) masks of pixels clearly inside an outline and clearly outside of all."""
    inside = np.zeros((_CAMERA.height_px, _CAMERA.width_px), np.uint8)
    for outline in outlines:
        cv2.fillPoly(inside, [np.reshape(outline, (-1, 2)).astype(np.int32)], [1])
    kernel = np.ones((2 * _EDGE_PX + 1, 2 * _EDGE_PX + 1), np.uint8)
    return cv2.erode(inside, kernel) > 0, cv2.dilate(inside, kernel) == 0
