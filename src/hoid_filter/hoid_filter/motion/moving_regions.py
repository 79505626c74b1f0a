"""Moving regions of an image, from the log-odds that each pixel moves."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.values import ByteArray, Float32Array, FloatArray, IntArray
from hoid_filter.motion.downscaled_camera import DownscaledCamera, DownscaledView
from hoid_native import propagate_log_odds

# Evidence of motion is defined for one image at 30 Hz, and scaled by the time since the previous
# image, so that the result does not depend on the frame rate.
EVIDENCE_PERIOD_S = 1 / 30
_MAX_EVIDENCE_SCALE = 4.0  # chosen limit, so that one image after a gap does not decide alone
# Coefficients of 1, z and z^2. Chosen: a pixel inherits the log-odds of the previous image if its
# depth z has changed by less than 0.05 m + 3 % of z. Without this check, a trial lost twice as
# many static corners.
_SAME_SURFACE_MARGIN = 0.05, 0.03, 0.0
# Chosen: limits the probability to 95 %, so that contrary evidence can still change the result.
_MAX_LOG_ODDS = 3.0
# Chosen: a region consists of pixels with a probability of motion above 0.67, and contains a pixel
# with a probability above 0.88 (hysteresis).
_MOVING_LOG_ODDS, _CERTAIN_LOG_ODDS = 0.7, 2.0
# Chosen: least area of a region as a ratio of the image, 38 px of 160x120. Smaller regions are
# mostly noise at depth edges.
_MIN_REGION_RATIO = 0.002
# Regions are grown by this, because pixels on a depth edge belong to no segment and get no
# evidence.
_EDGE_WIDTH_PX = 2


class MovingRegions(NamedTuple):
    """N regions of one image that move in the world."""

    boxes_xyxy_px: Float32Array  # (N, 4) in the full image
    depths_m: FloatArray  # (N,) median depths
    velocities_mps: FloatArray  # (N, 3) relative to the world, along camera axes; NaN = unknown
    label: ByteArray  # (h, w) at low resolution: 0 = static, else 1 + index of the region
    camera: DownscaledCamera | None  # maps pixels to the label image; None: no regions
    camera_turn_radps: float = 0.0  # turn rate of the camera; 0 = unknown

    def label_at(self, pixels: IntArray) -> ByteArray:
        """Return the labels of flat full-image pixels: 0 = static, else 1 + index of region."""
        if self.camera is None or not len(self.depths_m):
            return np.zeros(pixels.shape, np.uint8)
        return self.label.ravel()[self.camera.downscaled_of_pixel[pixels]]

    def select(self, index: IntArray) -> MovingRegions:
        return self._replace(
            boxes_xyxy_px=self.boxes_xyxy_px[index],
            depths_m=self.depths_m[index],
            velocities_mps=self.velocities_mps[index],
        )


NO_MOVING_REGIONS = MovingRegions(
    np.empty((0, 4), np.float32), np.empty(0), np.empty((0, 3)), np.zeros((1, 1), np.uint8), None
)


class LabeledRegions(NamedTuple):
    """The R moving regions of a downscaled image, as a label image."""

    label: IntArray  # (h, w), 0 = static, else 1 + index of the region
    boxes_xywh_px: IntArray  # (R, 4) left, top, width and height in the downscaled image

    @staticmethod
    def none(shape_hw: tuple[int, ...]) -> LabeledRegions:
        return LabeledRegions(np.zeros(shape_hw, np.int64), np.empty((0, 4), np.int64))

    @property
    def num_regions(self) -> int:
        return len(self.boxes_xywh_px)


class MotionLogOdds:
    """Log-odds (h, w) that each pixel of the downscaled image moves; 0 = unknown.

    They decay to 0 with time constant `decay_s`.
    """

    def __init__(self, camera: DownscaledCamera, decay_s: float) -> None:
        self._camera = camera
        self._decay_s = decay_s
        self._previous: DownscaledView | None = None
        self.log_odds = np.zeros(camera.shape_hw, np.float32)

    def reset(self) -> None:
        self.log_odds = np.zeros_like(self.log_odds)

    def static_probability(self, pixels: IntArray) -> FloatArray:
        """Return the probabilities (N,) that pixels (flat, downscaled) are static."""
        log_odds: FloatArray = self.log_odds.ravel()[pixels].astype(np.float64)
        return 1 / (1 + np.exp(log_odds))

    def update(
        self, view: DownscaledView, T_previous_current: FloatArray, evidence: FloatArray
    ) -> None:
        """Warp the log-odds to a new view, let them decay, and add new evidence of motion.

        `evidence` (S,) has the log-odds of each segment, per `EVIDENCE_PERIOD_S`.
        `T_previous_current` (4, 4) is the camera motion since the last update.
        """
        previous = view if self._previous is None else self._previous
        elapsed_s = (
            EVIDENCE_PERIOD_S if self._previous is None else view.stamp_s - previous.stamp_s
        )
        scale = min(elapsed_s / EVIDENCE_PERIOD_S, _MAX_EVIDENCE_SCALE)
        self.log_odds = propagate_log_odds(
            self._camera.depth_pinhole,
            T_previous_current,
            view.depth_m,
            previous.depth_m,
            self.log_odds,
            _SAME_SURFACE_MARGIN,
            math.exp(-elapsed_s / self._decay_s),
            view.segments.label,
            (evidence * scale).astype(np.float32),
            _MAX_LOG_ODDS,
        )
        self._previous = view

    def moving_regions(self) -> LabeledRegions:
        """Return the connected regions of probably moving pixels that contain a certain pixel."""
        certain, moving = self.log_odds > _CERTAIN_LOG_ODDS, self.log_odds > _MOVING_LOG_ODDS
        min_area_px = _MIN_REGION_RATIO * moving.size
        if not certain.any() or np.count_nonzero(moving) < min_area_px:
            return LabeledRegions.none(certain.shape)
        # 16-bit labels take a third of the time of 32-bit ones.
        count, label, raw_stats, _ = cv2.connectedComponentsWithStats(
            moving.view(np.uint8), connectivity=8, ltype=cv2.CV_16U
        )
        accepted = np.zeros(count, np.bool_)
        accepted[label[certain]] = True
        stats = np.asarray(raw_stats, np.int64)
        accepted &= stats[:, cv2.CC_STAT_AREA] >= min_area_px
        accepted[0] = False  # label 0 is the background
        if not accepted.any():
            return LabeledRegions.none(certain.shape)
        number = np.where(accepted, np.cumsum(accepted), 0)
        return LabeledRegions(
            number.take(np.asarray(label, np.int64)), stats[accepted, : cv2.CC_STAT_AREA]
        )


def dilate_labels(label: IntArray) -> ByteArray:
    side = 2 * _EDGE_WIDTH_PX + 1
    dilated = cv2.dilate(label.astype(np.uint8), np.ones((side, side), np.uint8))
    return np.asarray(dilated, np.uint8)
