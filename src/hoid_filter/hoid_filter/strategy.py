"""The interface of a filter strategy: its input, its output, and how one is made by name."""

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
from hoid_filter.config import FilterConfig
from hoid_filter.motion.moving_regions import NO_MOVING_REGIONS, MovingRegions
from hoid_filter.strategy_registry import load_strategy


class FilterInput(NamedTuple):
    """One image as a strategy receives it: detections, depth, corners and moving regions."""

    stamp_ns: int
    # Clipped to the image. Of this image or of an older one; None: the detector sent nothing new.
    detections: Detections | None
    depth_m: Float32Array  # (H, W); 0 = no reading
    corner_pixels: IntArray  # (K,) FAST corners, as indices into the flattened image
    moving_regions: MovingRegions = NO_MOVING_REGIONS  # of this image, detected or not


class Verdict(NamedTuple):
    """Which of N objects are dynamic, and which of the image's K corners lie on static surface.

    Corners are classified instead of pixels: a full-resolution mask would take longer than the
    rest of the strategy.
    """

    boxes_xyxy_px: Float32Array  # (N, 4)
    class_names: tuple[str, ...]  # N
    scores: Float32Array  # (N,)
    track_ids: IntArray  # (N,); -1 = not tracked
    reasons: tuple[Reason, ...]  # N
    overlap_ratios: FloatArray  # (N,) in [0, 1]: share of the object that a person's box covers
    depths_m: FloatArray  # (N,); NaN = unknown
    depth_gaps_m: FloatArray  # (N,) to the person with that overlap; NaN = unknown
    static_area_px: int  # unmasked area of the image
    kept: IntArray | None  # indices of the static ones of the K corners, ascending; None = all
    dynamic_mask: BoolArray | None = None  # (h, w) at low resolution; None: the dynamic boxes
    velocities_mps: FloatArray | None = None  # (N, 3) of undetected moving regions, else NaN
    # (h, w) at low resolution: detected dynamic objects. Motion segmentation estimates the camera
    # motion of the next image without them.
    detected_mask: BoolArray | None = None

    def known_velocities_mps(self) -> FloatArray:
        """Return (N, 3) velocities in the world, in camera axes; NaN = unknown."""
        if self.velocities_mps is None:
            return np.full((len(self.class_names), 3), np.nan)
        return self.velocities_mps


def append_objects(verdict: Verdict, other: Verdict) -> Verdict:
    """Return a verdict with the objects of another one on the same image; masks are kept."""
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


class FilterStrategy(Protocol):
    """Classifies the objects of an image as static or dynamic.

    The class is called with the `FilterConfig`. A new object is made whenever the stamps start
    anew, so a strategy may keep state from image to image.
    """

    needs_detections: bool  # False: no detector is started and no image waits for detections
    senses_motion: bool  # True: `FilterInput.moving_regions` is filled by motion segmentation

    def classify(self, image: FilterInput) -> Verdict:
        """Return the verdict on one image.

        Images come in order of time. An image is classified a second time, with the corners that
        were published, when its own detections or its moving regions become known.
        """


def make_strategy(config: FilterConfig) -> FilterStrategy:
    """Return a new strategy of the configured name."""
    strategy: FilterStrategy = load_strategy(config.strategy)(config)
    return strategy


def needs_detections(config: FilterConfig) -> bool:
    """Return whether the configured strategy uses a detector's boxes."""
    return bool(load_strategy(config.strategy).needs_detections)
