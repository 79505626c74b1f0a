"""ORB features of an RGB-D image, spread evenly over the part of the image that may be used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import cv2
import numpy as np

from hoid_common.values import (
    DESCRIPTOR_BYTES,
    BoolArray,
    ByteArray,
    Features,
    Float32Array,
    IntArray,
)
from hoid_filter.config import ExtractionConfig
from hoid_filter.spread import octave_budgets, spread_evenly

_PATCH_PX = 31  # of the descriptor, as in the ORB paper


@dataclass(frozen=True, eq=False)
class Corners:
    """The corners of one image, before any choice."""

    image_gray: ByteArray  # (H, W)
    key_points: Sequence[cv2.KeyPoint]  # K
    uv_px: Float32Array  # (K, 2), level-0 pixels
    octave: ByteArray  # (K,)
    response: Float32Array  # (K,)

    def __len__(self) -> int:
        return len(self.octave)


class OrbExtractor:
    """Finds corners in a pyramid, masks, spreads and describes them (Rublee et al., 2011)."""

    def __init__(self, config: ExtractionConfig) -> None:
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
        corners = self.detect(image_gray)
        chosen = self.choose(corners, keep_mask)
        return self.describe(corners, chosen, depth_m, stamp_ns)

    def detect(self, image_gray: ByteArray) -> Corners:
        """Return the corners of an (H, W) image on all levels of its pyramid."""
        found = self._orb.detect(image_gray)
        return Corners(
            image_gray,
            found,
            _positions(found),
            _attribute(found, 'octave', np.uint8),
            _attribute(found, 'response', np.float32),
        )

    def choose(self, corners: Corners, keep_mask: ByteArray | None) -> IntArray:
        """Return the indices of the corners to keep, spread over the part of the image to keep."""
        if keep_mask is None:
            area_px = corners.image_gray.size
            among = np.arange(len(corners))
        else:
            area_px = cv2.countNonZero(keep_mask)
            among = np.flatnonzero(lies_in(keep_mask, corners.uv_px))
        kept = spread_evenly(
            corners.uv_px[among],
            corners.octave[among],
            corners.response[among],
            self._budgets,
            float(area_px),
        )
        return among[kept]

    def describe(
        self, corners: Corners, chosen: IntArray, depth_m: Float32Array, stamp_ns: int
    ) -> Features:
        """Return the features at the chosen corners."""
        points, descriptors = self._orb.compute(
            corners.image_gray, [corners.key_points[k] for k in chosen.tolist()]
        )
        return _to_features(points, descriptors, depth_m, stamp_ns)


def lies_in(mask: ByteArray, uv_px: Float32Array) -> BoolArray:
    """Return the (N,) flags of the pixels where an (H, W) mask is not 0."""
    column, row = np.rint(uv_px).astype(np.int64).T
    inside: BoolArray = mask[row, column] > 0
    return inside


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
        descriptors=descriptors if num else np.empty((0, DESCRIPTOR_BYTES), np.uint8),
        may_seed=np.ones(num, np.bool_),
    )


def sample_depth_m(depth_m: Float32Array, uv_px: Float32Array) -> Float32Array:
    """Return the (N,) depths of an (H, W) image's nearest pixels; 0 where there is no reading."""
    column, row = np.rint(uv_px).astype(np.int64).T
    values = depth_m[row, column]
    return np.where(values > 0, values, np.float32(0))  # NaN > 0 is false
