"""ORB features of an RGB-D image, spread evenly over the part of the image that may be used."""

from __future__ import annotations

from collections.abc import Callable

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
from hoid_filter.pyramid import Corners, Int32Array, build_pyramid, find_corners, flat_pixels
from hoid_filter.spread import octave_budgets, spread_evenly
from hoid_native import corner_peaks_px, orientations_deg

_Measure = Callable[[ByteArray, Int32Array, Int32Array], Float32Array]

_NO_BOXES: Float32Array = np.empty((0, 4), np.float32)
_PATCH_PX = 31  # of the descriptor, as in the ORB paper


class OrbExtractor:
    """Finds corners in a pyramid, masks, spreads and describes them (Rublee et al., 2011)."""

    def __init__(self, config: ExtractionConfig) -> None:
        self._config = config
        self._describer = cv2.ORB.create(
            nfeatures=config.num_features,
            scaleFactor=config.scale_factor,
            nlevels=config.num_levels,
            edgeThreshold=config.border_px,
            patchSize=_PATCH_PX,
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
        if keep_mask is None:
            chosen = self.choose(corners, None, image_gray.size)
        else:
            kept = np.flatnonzero(keep_mask.ravel()[corners.pixel] > 0)
            chosen = self.choose(corners, kept, cv2.countNonZero(keep_mask))
        return self.describe(corners, chosen, depth_m, stamp_ns)

    def detect(self, image_gray: ByteArray) -> Corners:
        """Return the corners of an (H, W) image on all levels of its pyramid."""
        config = self._config
        pyramid = build_pyramid(image_gray, config.num_levels, config.scale_factor)
        return find_corners(pyramid, config.fast_threshold, config.border_px)

    def choose(self, corners: Corners, kept: IntArray | None, static_area_px: int) -> IntArray:
        """Return the indices, ascending, of corners to describe, spread over what is static.

        Args:
            kept: indices, ascending, of the corners there; None for all.
            static_area_px: of the image.
        """
        if kept is not None and self._config.refill:
            return self._spread(corners, kept, static_area_px)
        everything, size_px = np.arange(len(corners)), corners.pyramid.levels[0].size
        chosen = self._spread(corners, everything, size_px)
        return chosen if kept is None else np.intersect1d(chosen, kept, assume_unique=True)

    def _spread(self, corners: Corners, among: IntArray, area_px: int) -> IntArray:
        kept = spread_evenly(
            corners.uv_px.take(among, axis=0),  # 40 times as fast as an index
            corners.octave[among],
            corners.score[among],
            self._budgets,
            float(area_px),
        )
        return among[kept]

    def describe(
        self,
        corners: Corners,
        chosen: IntArray,
        depth_m: Float32Array,
        stamp_ns: int,
        moving_xyxy_px: Float32Array = _NO_BOXES,
    ) -> Features:
        """Return the features at the chosen corners, which are in order of octave.

        A corner outside the boxes (N, 4) of what moves gives a feature outside of them.
        """
        angle_deg = _by_level(orientations_deg, corners, chosen)
        uv_px = corners.uv_px.take(chosen, axis=0)
        peak_px = uv_px + self._peaks_px(corners, chosen)
        if len(moving_xyxy_px):
            entering = (_inside(peak_px, moving_xyxy_px) & ~_inside(uv_px, moving_xyxy_px)).any(1)
            peak_px[entering] = uv_px[entering]
        return Features(
            stamp_ns=stamp_ns,
            uv_px=peak_px,
            depth_m=sample_depth_m(depth_m, peak_px),
            octave=corners.octave[chosen],
            angle_deg=angle_deg,
            response=corners.score[chosen].astype(np.float32),
            descriptors=self._descriptors(corners, chosen, angle_deg),
            may_seed=np.ones(len(chosen), np.bool_),
        )

    def _peaks_px(self, corners: Corners, chosen: IntArray) -> Float32Array:
        """Return the (N, 2) level-0 offsets from corners' pixels to where they are strongest."""
        steps_px = corners.pyramid.steps_px[corners.octave[chosen]]
        return _by_level(corner_peaks_px, corners, chosen) * steps_px

    def _descriptors(
        self, corners: Corners, chosen: IntArray, angle_deg: Float32Array
    ) -> ByteArray:
        if len(chosen) == 0:
            return np.empty((0, DESCRIPTOR_BYTES), np.uint8)
        octave = corners.octave[chosen]
        # OpenCV divides by the nominal scale and rounds to find the level's pixel again.
        scale = self._config.scale_factor ** octave[:, None].astype(np.float64)
        nominal_px = corners.xy_px[chosen] * scale
        points = [
            cv2.KeyPoint(u, v, _PATCH_PX, angle, 1.0, level)
            for (u, v), angle, level in zip(
                nominal_px.tolist(), angle_deg.tolist(), octave.tolist(), strict=True
            )
        ]
        described, descriptors = self._describer.compute(corners.pyramid.levels[0], points)
        if len(described) != len(points):
            raise AssertionError('a corner within the border was not described')
        return np.asarray(descriptors, np.uint8)


def _by_level(measure: _Measure, corners: Corners, chosen: IntArray) -> Float32Array:
    """Measure the chosen corners, which are in order of octave, each in the image of its level."""
    octave = corners.octave[chosen]
    xy_px = corners.xy_px[chosen]
    ends = np.searchsorted(octave, np.arange(len(corners.pyramid.levels) + 1)).tolist()
    return np.concatenate(
        [
            measure(level, xy_px[first:last, 0], xy_px[first:last, 1])
            for level, first, last in zip(corners.pyramid.levels, ends, ends[1:], strict=False)
        ]
    )


def _inside(uv_px: Float32Array, boxes_xyxy_px: Float32Array) -> BoolArray:
    """Return (K, N): whether the centre of each position's pixel is in each box."""
    centers_px = np.rint(uv_px)[:, None]
    first, end = boxes_xyxy_px[:, :2], boxes_xyxy_px[:, 2:]
    return np.logical_and((centers_px >= first).all(2), (centers_px < end).all(2))


def sample_depth_m(depth_m: Float32Array, uv_px: Float32Array) -> Float32Array:
    """Return the (N,) depths of an (H, W) image's nearest pixels; 0 where there is no reading."""
    values = depth_m.ravel()[flat_pixels(uv_px, depth_m.shape[1])]
    return np.where(values > 0, values, np.float32(0))  # NaN > 0 is false
