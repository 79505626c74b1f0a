"""The strategy `motion`: what moves is dynamic, whatever it is, and no detector is asked."""

from __future__ import annotations

import numpy as np

from hoid_common.values import UNKNOWN, Reason
from hoid_filter.config import FilterConfig
from hoid_filter.detections.aligned_detections import FilterInput, Verdict
from hoid_filter.motion.moving_regions import Moving
from hoid_filter.rules.depth_regions import small_pixels
from hoid_filter.rules.dynamic_mask import Masks, make_masks, moving_confidence


class MotionOnly:
    """Masks what moves in the world."""

    def __init__(self, config: FilterConfig) -> None:
        self._config = config

    def judge(self, view: FilterInput) -> Verdict:
        """Return the regions that move."""
        moving = view.moving
        plus = self._config.plus
        confidence = moving_confidence(moving.label_at(small_pixels(view.depth_m.shape)))
        enough = plus.min_static_share * self._config.extraction.num_features
        return moving_verdict(moving, make_masks(confidence, view, plus, enough))


def moving_verdict(moving: Moving, masks: Masks) -> Verdict:
    """Return a verdict on regions that move and nothing else."""
    num = len(moving.depths_m)
    return Verdict(
        boxes_xyxy_px=moving.boxes_xyxy_px,
        class_names=(UNKNOWN,) * num,
        scores=np.ones(num, np.float32),
        track_ids=np.full(num, -1),
        reasons=(Reason.MOVING,) * num,
        overlap_ratios=np.zeros(num),
        depths_m=moving.depths_m,
        depth_gaps_m=np.full(num, np.nan),
        static_area_px=masks.static_area_px,
        kept=masks.kept,
        seeds=masks.seeds,
        fallback_step=masks.step,
        moves=masks.moves,
        velocities_mps=moving.velocities_mps,
    )
