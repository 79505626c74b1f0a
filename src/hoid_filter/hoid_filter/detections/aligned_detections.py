"""What a strategy looks at and what it answers."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from hoid_common.values import (
    BoolArray,
    Detections,
    Float32Array,
    FloatArray,
    IntArray,
    Reason,
)
from hoid_filter.motion.moving_regions import NOTHING, Moving


class FilterInput(NamedTuple):
    """One image as a strategy gets it."""

    stamp_ns: int
    detections: Detections | None  # clipped; of this image or an older one; None: nothing was said
    depth_m: Float32Array  # (H, W); 0 = no reading
    corner_pixels: IntArray  # (K,) of the corners found, as indices in the flat image
    moving: Moving = NOTHING  # what is known to move in it, detected or not


class AlignedDetections(NamedTuple):
    """Boxes brought to the stamp of an image."""

    detections: Detections  # at the image's stamp, inside the image
    detected: bool  # False: the boxes are predicted, the detector said nothing about this image


class Verdict(NamedTuple):
    """Which of N objects are dynamic, and which of the view's K corners are not on one.

    Corners are marked instead of pixels: a mask of full size takes longer than all the rest.
    """

    boxes_xyxy_px: Float32Array  # (N, 4)
    class_names: tuple[str, ...]  # N
    scores: Float32Array  # (N,)
    track_ids: IntArray  # (N,); -1 = not tracked
    reasons: tuple[Reason, ...]  # N
    overlap_ratios: FloatArray  # (N,), in [0, 1]
    depths_m: FloatArray  # (N,); NaN = unknown
    depth_gaps_m: FloatArray  # (N,), to the person who overlaps; NaN = unknown
    static_area_px: int  # of the image
    kept: IntArray | None  # of the K corners, ascending, what is on something static; None = all
    seeds: BoolArray | None = None  # (K,) corners that may become map points; None = all
    fallback_step: int = 0  # how far the mask was relaxed for lack of static features
    moves: BoolArray | None = None  # (h, w) of a small image, what is masked; None: by the boxes
    velocities_mps: FloatArray | None = None  # (N, 3) of what moves undetected, else NaN
    detected: BoolArray | None = None  # (h, w) of a small image, on what is detected and dynamic

    def known_velocities_mps(self) -> FloatArray:
        """Return (N, 3) velocities against the world along the camera's axes; NaN = unknown."""
        if self.velocities_mps is None:
            return np.full((len(self.class_names), 3), np.nan)
        return self.velocities_mps


def joined(verdict: Verdict, other: Verdict) -> Verdict:
    """Return a verdict, mask and all, with the objects of another on the same image added."""
    if not other.class_names:
        return verdict
    return verdict._replace(
        boxes_xyxy_px=np.concatenate([verdict.boxes_xyxy_px, other.boxes_xyxy_px]),
        class_names=verdict.class_names + other.class_names,
        scores=np.concatenate([verdict.scores, other.scores]),
        track_ids=np.concatenate([verdict.track_ids, other.track_ids]),
        reasons=verdict.reasons + other.reasons,
        overlap_ratios=np.concatenate([verdict.overlap_ratios, other.overlap_ratios]),
        depths_m=np.concatenate([verdict.depths_m, other.depths_m]),
        depth_gaps_m=np.concatenate([verdict.depth_gaps_m, other.depth_gaps_m]),
        velocities_mps=np.concatenate(
            [verdict.known_velocities_mps(), other.known_velocities_mps()]
        ),
    )


class Strategy(Protocol):
    """Tells which objects are dynamic."""

    def judge(self, view: FilterInput) -> Verdict:
        """Return the verdict on one image.

        Images come in order of time. One may come again when more is known of it, with the corners
        that matter.
        """
