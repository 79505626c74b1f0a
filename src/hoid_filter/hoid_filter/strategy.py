"""The interface of a filter strategy: its input, its output, and the function that creates it."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import (
    BoolArray,
    Detections,
    Float32Array,
    FloatArray,
    IntArray,
    ObjectState,
)
from hoid_filter.config import FilterConfig
from hoid_filter.motion.moving_regions import NO_MOVING_REGIONS, MovingRegions
from hoid_filter.strategy_registry import load_strategy


class FilterInput(NamedTuple):
    """The input of a strategy for one image: detections, depth, corners and moving regions."""

    stamp_ns: int
    # Detected boxes, clipped to the image: of this image, of an older one or, when the image is
    # classified again, of a later one. None: no new boxes have come since the last call.
    detections: Detections | None
    depth_m: Float32Array  # (H, W); 0 = no depth
    # (K,) indices into the flattened image: FAST corners or, when the image is classified again,
    # published features.
    corner_pixels: IntArray
    # From motion segmentation of this image or, if that is not done yet, of an older one.
    moving_regions: MovingRegions = NO_MOVING_REGIONS


class ObjectVerdicts(NamedTuple):
    """The boxes of N objects in one image, and why each object is static or dynamic."""

    boxes_xyxy_px: Float32Array  # (N, 4)
    class_names: tuple[str, ...]  # N
    scores: Float32Array  # (N,) confidences of the detections, in [0, 1]
    reasons: tuple[ObjectState, ...]  # N reasons why an object is static or dynamic
    track_ids: IntArray  # (N,); -1 = not tracked
    # (N,) in [0, 1]: ratio of the object's box that a person's box covers.
    overlap_ratios: FloatArray
    depths_m: FloatArray  # (N,); NaN = unknown
    depth_gaps_m: FloatArray  # (N,) absolute depth difference to that person; NaN = unknown
    velocities_mps: FloatArray  # (N, 3) relative to the world, along camera axes; NaN = unknown

    @staticmethod
    def of(
        boxes_xyxy_px: Float32Array,
        class_names: tuple[str, ...],
        scores: Float32Array,
        reasons: tuple[ObjectState, ...],
        **known: NDArray[Any],
    ) -> ObjectVerdicts:
        """Return the classification of N objects; fields that are not in `known` are unknown."""
        num = len(class_names)
        unknown: dict[str, NDArray[Any]] = {
            'track_ids': np.full(num, -1),
            'overlap_ratios': np.zeros(num),
            'depths_m': np.full(num, np.nan),
            'depth_gaps_m': np.full(num, np.nan),
            'velocities_mps': np.full((num, 3), np.nan),
        }
        return ObjectVerdicts(boxes_xyxy_px, class_names, scores, reasons, **(unknown | known))

    def joined(self, other: ObjectVerdicts) -> ObjectVerdicts:
        return ObjectVerdicts._make(map(_concatenated, self, other))


def _concatenated(first: Any, second: Any) -> Any:
    return first + second if isinstance(first, tuple) else np.concatenate([first, second])


class Verdict(NamedTuple):
    """Which objects of an image are dynamic, and which of its K corners lie on static surface."""

    objects: ObjectVerdicts
    static_area_px: int  # unmasked area of the image
    kept: IntArray | None  # ascending indices of the corners on static surface; None = all K
    # (h, w) all dynamic pixels, at low resolution. None: the boxes of the dynamic objects.
    dynamic_mask: BoolArray | None = None
    # (h, w) dynamic objects that were detected, or predicted from detections, at low resolution.
    # Motion segmentation does not use their points for the camera pose if enough others remain.
    detected_mask: BoolArray | None = None


class FilterStrategy(Protocol):
    """Classifies the objects of an image as static or dynamic; created from a `FilterConfig`.

    It may keep state between images. A new strategy is created when parameters change, and when
    the stamps go back by a second or more.
    """

    needs_detections: bool  # False: no detector is started, and no image waits for detections
    senses_motion: bool  # True: `FilterInput.moving_regions` is filled by motion segmentation

    def classify(self, image: FilterInput) -> Verdict:
        """Return which objects of an image are dynamic and which of its corners are kept.

        New images come in order of time. An image may be classified again, even after newer ones,
        when its detections or moving regions have become known; the corners are then the features
        that were published.
        """


def make_strategy(config: FilterConfig) -> FilterStrategy:
    strategy: FilterStrategy = load_strategy(config.strategy)(config)
    return strategy


def needs_detections(config: FilterConfig) -> bool:
    return bool(load_strategy(config.strategy).needs_detections)
