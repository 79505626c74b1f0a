"""ORB features of an RGB-D image, spread evenly over the part of the image that may be used."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import cv2
import numpy as np

from hoid_common.values import DESCRIPTOR_BYTES, ByteArray, Features, Float32Array, IntArray
from hoid_filter.config import ExtractionConfig
from hoid_filter.spread import octave_budgets, spread_evenly

_PATCH_PX = 31  # of the descriptor, as in the ORB paper


class OrbExtractor:
    """Finds corners in a pyramid, masks, spreads and describes them (Rublee et al., 2011)."""

    def __init__(self, config: ExtractionConfig) -> None:
        self._config = config
        # FAST's own score: the Harris score crowds the corners into few strongly textured places.
        self._orb = cv2.ORB.create(
            nfeatures=config.num_candidates,
            scaleFactor=config.scale_factor,
            nlevels=config.num_levels,
            edgeThreshold=config.border_px,
            scoreType=cv2.ORB_FAST_SCORE,
            patchSize=_PATCH_PX,
            fastThreshold=config.fast_threshold,
        )
        self._budgets = octave_budgets(config.num_features, config.num_levels, config.scale_factor)

    def extract(
        self,
        image_gray: ByteArray,
        depth_m: Float32Array,
        keep_mask: ByteArray | None,
        stamp_ns: int,
    ) -> Features:
        """Return at most `num_features` features.

        Args:
            image_gray: (H, W).
            depth_m: (H, W); 0 or NaN = no reading.
            keep_mask: (H, W), 0 where no feature may lie; None for the whole image.
        """
        found = self._orb.detect(image_gray, keep_mask)
        area_px = image_gray.size if keep_mask is None else cv2.countNonZero(keep_mask)
        kept = self._spread(found, float(area_px))
        described, descriptors = self._orb.compute(image_gray, [found[k] for k in kept])
        return _to_features(described, descriptors, depth_m, stamp_ns)

    def _spread(self, found: Sequence[cv2.KeyPoint], area_px: float) -> IntArray:
        uv_px = _positions(found)
        octave = np.fromiter(map(attrgetter('octave'), found), np.uint8, len(found))
        response = np.fromiter(map(attrgetter('response'), found), np.float32, len(found))
        return spread_evenly(uv_px, octave, response, self._budgets, area_px)


def _positions(points: Sequence[cv2.KeyPoint]) -> Float32Array:
    return np.asarray(cv2.KeyPoint.convert(points), np.float32).reshape(-1, 2)


def _attribute(points: Sequence[cv2.KeyPoint], name: str, dtype: Any) -> Any:
    return np.fromiter(map(attrgetter(name), points), dtype, len(points))


def _to_features(
    points: Sequence[cv2.KeyPoint],
    descriptors: Any,
    depth_m: Float32Array,
    stamp_ns: int,
) -> Features:
    num = len(points)
    uv_px = _positions(points)
    return Features(
        stamp_ns=stamp_ns,
        uv_px=uv_px,
        depth_m=sample_depth_m(depth_m, uv_px),
        octave=_attribute(points, 'octave', np.uint8),
        angle_deg=_attribute(points, 'angle', np.float32),
        response=_attribute(points, 'response', np.float32),
        descriptors=np.empty((0, DESCRIPTOR_BYTES), np.uint8)
        if descriptors is None
        else descriptors,
        may_seed=np.ones(num, np.bool_),
    )


def sample_depth_m(depth_m: Float32Array, uv_px: Float32Array) -> Float32Array:
    """Return the (N,) depths of an (H, W) image's nearest pixels; 0 where there is no reading."""
    column, row = np.rint(uv_px).astype(np.int64).T
    values = depth_m[row, column]
    return np.where(values > 0, values, np.float32(0))  # NaN > 0 is false
