"""Motion segmentation in pairs of recorded images (Jaimez et al., ICRA 2017).

The moving objects were outlined by eye. Two images are few: an object without corners that
occludes nothing new shows no motion, and the time between the images is unknown. The bounds are
the measured shares with a margin of a tenth.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest

from hoid_common.values import NS_PER_S, BoolArray, CameraModel, RgbdFrame
from hoid_filter.config import FilterConfig
from hoid_filter.feature_filter import FeatureFilter
from hoid_filter.masked_images import dynamic_mask

PAIRS = Path(__file__).parents[4] / 'shared' / 'data' / 'movers'
OUTLINES = json.loads((Path(__file__).parent / 'data' / 'movers.json').read_text())
CAMERA = CameraModel(640, 480, 527.0, 533.0, 319.5, 239.5)
UNITS_PER_M = 5000
GAP_NS = NS_PER_S // 10  # assumed, as they have no stamps

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not PAIRS.is_dir(), reason=f'needs the image pairs in {PAIRS}'),
]


class Shares(NamedTuple):
    """Shares of the pixels with depth."""

    found: float  # of the pixels on moving objects, masked
    lost: float  # of the static pixels, masked


def frame(name: str, n: int) -> RgbdFrame:
    bgr = cv2.imread(str(PAIRS / name / f'color{n}.png'))
    depth = cv2.imread(str(PAIRS / name / f'depth{n}.png'), cv2.IMREAD_UNCHANGED)
    assert bgr is not None
    assert depth is not None
    depth_m = (depth / UNITS_PER_M).astype(np.float32)
    return RgbdFrame(1 + n * GAP_NS, np.asarray(bgr, np.uint8), depth_m)


def outlined(name: str) -> BoolArray:
    mask = np.zeros((CAMERA.height_px, CAMERA.width_px), np.uint8)
    for polygon in OUTLINES[name]:
        cv2.fillPoly(mask, [np.array(polygon, np.int32)], 1)
    return mask > 0


def measured(name: str) -> Shares:
    motion = FeatureFilter(FilterConfig(strategy='motion'), CAMERA)
    for n in (0, 1):
        seen = frame(name, n)
        result = motion.process(seen, None)
    final = motion.reevaluate(result.features, seen.depth_m, None)
    moving = dynamic_mask(final.verdict, CAMERA.size_px)
    known, moves = seen.depth_m > 0, outlined(name)
    return Shares(float(moving[known & moves].mean()), float(moving[known & ~moves].mean()))


@pytest.mark.parametrize(
    ('name', 'least_found', 'most_lost'),
    [
        ('cleaning_whiteboard', 0.10, 0.06),
        ('opening_door', 0.24, 0.09),
        ('person_standing', 0.75, 0.12),
        ('two_people_moving', 0.55, 0.16),
    ],
)
def test_what_moves_between_two_images(name: str, least_found: float, most_lost: float) -> None:
    found, lost = measured(name)
    assert found > least_found
    assert lost < most_lost
