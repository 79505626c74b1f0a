"""The belief that pixels show what moves: log-odds that grow with evidence and fade with time."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.values import ByteArray, FloatArray, IntArray
from hoid_filter.motion.small_camera import SmallCamera
from hoid_filter.motion.small_view import SmallView
from hoid_native import carry_over

EVIDENCE_S = 1 / 30  # the time whose evidence is added as it is
_MOST_STEPS = 4.0  # of evidence, however long ago the image before was
_SAME_MARGIN = 0.05, 0.03, 0.0  # m, and shares of depth and its square: it is still the same
_LIMIT = 3.0  # of log-odds: a belief can be given up
_MOVES, _SURELY_MOVES = 0.7, 2.0
_LEAST_AREA = 0.002  # share of the image: less is noise at an edge
_WIDER_PX = 2  # beyond its pixels: those on edges of depth are of no segment


class MovingArea(NamedTuple):
    """Where the small image moves, and which connected part is which."""

    label: IntArray  # (h, w), 0 = rests, else 1 + index of the region
    boxes_xywh_px: IntArray  # (R, 4) of the regions in the small image

    @staticmethod
    def none(shape_hw: tuple[int, ...]) -> MovingArea:
        """Return that of an image at rest."""
        return MovingArea(np.zeros(shape_hw, np.int64), np.empty((0, 4), np.int64))

    @property
    def num_regions(self) -> int:
        """Return how many parts move."""
        return len(self.boxes_xywh_px)


class Belief:
    """Log-odds for each pixel of the small image."""

    def __init__(self, camera: SmallCamera, fade_s: float) -> None:
        self._camera = camera
        self._fade_s = fade_s
        self._before: SmallView | None = None
        self.log_odds = np.zeros(camera.shape_hw, np.float32)

    def forget(self) -> None:
        """Believe nothing any more."""
        self.log_odds = np.zeros_like(self.log_odds)

    def probability_at(self, pixels: IntArray) -> FloatArray:
        """Return the (N,) probabilities that flat pixels rest."""
        odds: FloatArray = self.log_odds.ravel()[pixels].astype(np.float64)
        return 1 / (1 + np.exp(odds))

    def update(self, view: SmallView, T_before_now: FloatArray, evidence: FloatArray) -> None:
        """Take the belief over to a view, where depth allows, and add (S,) evidence on segments.

        Args:
            view: of now.
            T_before_now: (4, 4) of the camera, since the last update.
            evidence: log-odds of `EVIDENCE_S` that each segment moves.
        """
        before = view if self._before is None else self._before
        since_s = EVIDENCE_S if self._before is None else view.stamp_s - before.stamp_s
        self.log_odds = carry_over(
            self._camera.depth_pinhole,
            T_before_now,
            view.depth_m,
            before.depth_m,
            self.log_odds,
            _SAME_MARGIN,
            math.exp(-since_s / self._fade_s),
            view.segments.label,
            (evidence * min(since_s / EVIDENCE_S, _MOST_STEPS)).astype(np.float32),
            _LIMIT,
        )
        self._before = view

    def moving(self) -> MovingArea:
        """Return what moves: connected parts, some pixel of which is believed to for sure."""
        surely, moves = self.log_odds > _SURELY_MOVES, self.log_odds > _MOVES
        least_px = _LEAST_AREA * moves.size
        if not surely.any() or np.count_nonzero(moves) < least_px:
            return MovingArea.none(surely.shape)
        # Labels of 16 bits take a third of the time of others.
        count, label, found, _ = cv2.connectedComponentsWithStats(
            moves.view(np.uint8), connectivity=8, ltype=cv2.CV_16U
        )
        sure = np.zeros(count, np.bool_)
        sure[label[surely]] = True
        stats = np.asarray(found, np.int64)
        sure &= stats[:, cv2.CC_STAT_AREA] >= least_px
        sure[0] = False
        if not sure.any():
            return MovingArea.none(surely.shape)
        number = np.where(sure, np.cumsum(sure), 0)
        return MovingArea(
            number.take(np.asarray(label, np.int64)), stats[sure, : cv2.CC_STAT_AREA]
        )


def widened(label: IntArray) -> ByteArray:
    """Return the (h, w) labels, of less than 256 regions, with the pixels beside them."""
    side = 2 * _WIDER_PX + 1
    grown = cv2.dilate(label.astype(np.uint8), np.ones((side, side), np.uint8))
    return np.asarray(grown, np.uint8)
