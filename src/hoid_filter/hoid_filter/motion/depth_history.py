"""Depth images of the last seconds, and the evidence of motion from occlusion of them."""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

from hoid_common import se3
from hoid_common.values import Float32Array, FloatArray
from hoid_filter.motion.downscaled_camera import DownscaledCamera
from hoid_filter.motion.downscaled_view import DownscaledView
from hoid_native import depth_ranges_3x3, occlusion_log_odds

_MIN_SPACING_S = (
    1 / 40
)  # chosen: every image of a 30 Hz camera is kept, every other of a 60 Hz one
# Chosen: an image may miss the wanted age by 30 % of it, or by 0.1 s at low frame rates.
_AGE_TOLERANCE, _MIN_AGE_TOLERANCE_S = 0.3, 0.1
# A point is in front when it is nearer by more than 0.03 m + 1.5 % z + 0.8 % z^2. Chosen: well
# above depth noise, which grows with the square of the depth, and the error of the poses.
_OCCLUSION_MARGIN = 0.03, 0.015, 0.008
_OCCLUSION_LOG_ODDS = 1.5  # chosen: a segment wholly in front is certain within 2 images
_MIN_OCCLUDING_SHARE = 0.1  # chosen: less of a segment in front is its depth edges
# Chosen: with a larger share in front, agreement of the rest is no evidence of a static segment.
_MIXED_SHARE = 0.25


class _Baseline(NamedTuple):
    """An age to compare with, and the evidence that an unchanged depth gives."""

    age_s: float
    static_log_odds: float


# Chosen: the ages double and more, so that both fast and slow objects show. In a trial, objects
# at 1/8 of walking speed were found only with a baseline of 2 to 3 s. A slow object still overlaps
# its place of 0.2 s ago, hence unchanged depth counts little for the short ages.
_BASELINES = (
    _Baseline(0.17, 0.05),
    _Baseline(0.4, 0.1),
    _Baseline(1.0, 0.25),
    _Baseline(2.5, 0.4),
)


class _PastDepth(NamedTuple):
    """A past depth image and its camera pose."""

    stamp_s: float
    T_camera_world: FloatArray
    range_m: Float32Array  # (h, w, 2) least and greatest depth in the 3x3 pixels around each


class DepthHistory:
    """Past depth images with their poses, up to the greatest age that is compared with."""

    def __init__(self, camera: DownscaledCamera) -> None:
        self._camera = camera
        self._past: list[_PastDepth] = []

    def add(self, view: DownscaledView, T_world_camera: FloatArray) -> None:
        """Store a view and drop those that are too old."""
        if self._past and view.stamp_s - self._past[-1].stamp_s < _MIN_SPACING_S:
            return
        range_m = depth_ranges_3x3(view.depth_m)
        self._past.append(_PastDepth(view.stamp_s, se3.inverse(T_world_camera), range_m))
        oldest_s = view.stamp_s - _BASELINES[-1].age_s * (1 + _AGE_TOLERANCE)
        while self._past[0].stamp_s < oldest_s:
            del self._past[0]

    def occlusion_evidence(self, view: DownscaledView, T_world_camera: FloatArray) -> FloatArray:
        """Return the (S,) log-odds, per `EVIDENCE_PERIOD_S`, that each segment of a view moves.

        A surface in front of what an earlier image showed there has moved in. A surface behind it
        may have been hidden then: that is no evidence.
        """
        earlier = [
            (past.T_camera_world @ T_world_camera, past.range_m, baseline.static_log_odds)
            for baseline in _BASELINES
            if (past := self._nearest(view.stamp_s, baseline.age_s)) is not None
        ]
        return occlusion_log_odds(
            self._camera.depth_pinhole,
            view.depth_m,
            view.segments.label,
            len(view.segments.region),
            earlier,
            _OCCLUSION_MARGIN,
            (_OCCLUSION_LOG_ODDS, _MIN_OCCLUDING_SHARE, _MIXED_SHARE),
        )

    def _nearest(self, now_s: float, age_s: float) -> _PastDepth | None:
        """Return the depth image of about this age; None if there is none within tolerance."""
        if not self._past:
            return None
        tolerance_s = max(_AGE_TOLERANCE * age_s, _MIN_AGE_TOLERANCE_S)
        wanted_s = now_s - age_s
        n = bisect_left(self._past, wanted_s, key=lambda past: past.stamp_s)
        neighbors = [self._past[k] for k in (n - 1, n) if 0 <= k < len(self._past)]
        best = min(neighbors, key=lambda past: abs(past.stamp_s - wanted_s))
        return best if abs(best.stamp_s - wanted_s) <= tolerance_s else None
