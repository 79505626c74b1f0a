"""The strategy `motion`: every moving region is dynamic, and no detector is used."""

from __future__ import annotations

import numpy as np

from hoid_common.values import UNKNOWN, Reason
from hoid_filter.config import FilterConfig
from hoid_filter.motion.moving_regions import MovingRegions
from hoid_filter.strategies.depth_regions import subsampled_pixels
from hoid_filter.strategies.dynamic_mask import Mask, dilate_mask
from hoid_filter.strategy import FilterInput, Verdict


class MotionOnly:
    """Masks the moving regions."""

    needs_detections, senses_motion = False, True

    def __init__(self, config: FilterConfig) -> None:
        """Accept the configuration, of which this strategy needs nothing."""

    def classify(self, image: FilterInput) -> Verdict:
        """Return the moving regions as dynamic objects of unknown class."""
        regions = image.moving_regions
        is_moving = regions.label_at(subsampled_pixels(image.depth_m.shape)) > 0
        return moving_verdict(regions, dilate_mask(is_moving, image))


def moving_verdict(regions: MovingRegions, mask: Mask) -> Verdict:
    """Return the verdict that moving regions are the only objects of an image."""
    num = len(regions.depths_m)
    return Verdict(
        boxes_xyxy_px=regions.boxes_xyxy_px,
        class_names=(UNKNOWN,) * num,
        scores=np.ones(num, np.float32),
        track_ids=np.full(num, -1),
        reasons=(Reason.MOVING,) * num,
        overlap_ratios=np.zeros(num),
        depths_m=regions.depths_m,
        depth_gaps_m=np.full(num, np.nan),
        static_area_px=mask.static_area_px,
        kept=mask.kept,
        dynamic_mask=mask.is_dynamic,
        velocities_mps=regions.velocities_mps,
    )
