"""The strategy `motion`: every moving region is dynamic, and no detector is used."""

from __future__ import annotations

import numpy as np

from hoid_common.values import UNKNOWN, ObjectState
from hoid_filter.config import FilterConfig
from hoid_filter.motion.moving_regions import MovingRegions
from hoid_filter.strategies.dynamic_mask import masked, subsampled_pixels
from hoid_filter.strategy import FilterInput, ObjectVerdicts, Verdict


class MotionOnly:
    """Masks the moving regions that motion segmentation finds."""

    needs_detections, senses_motion = False, True

    def __init__(self, config: FilterConfig) -> None: ...

    def classify(self, image: FilterInput) -> Verdict:
        regions = image.moving_regions
        is_moving = regions.label_at(subsampled_pixels(image.depth_m.shape)) > 0
        return masked(is_moving, image, moving_objects(regions))


def moving_objects(regions: MovingRegions) -> ObjectVerdicts:
    """Return moving regions as dynamic objects of unknown class, with a score of 1."""
    num = len(regions.depths_m)
    return ObjectVerdicts.of(
        regions.boxes_xyxy_px,
        (UNKNOWN,) * num,
        np.ones(num, np.float32),
        (ObjectState.MOVING,) * num,
        depths_m=regions.depths_m,
        velocities_mps=regions.velocities_mps,
    )
