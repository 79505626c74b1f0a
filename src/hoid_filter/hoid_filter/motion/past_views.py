"""What was seen some time ago, and what is in front of it now."""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

from hoid_common import se3
from hoid_common.values import Float32Array, FloatArray
from hoid_filter.motion.small_camera import SmallCamera
from hoid_filter.motion.small_view import SmallView
from hoid_native import depths_around, front_evidence

_STEP_S = 1 / 40  # views nearer in time than this are one
_SLACK = 0.3  # share of a baseline by which it may be missed
_LEAST_SLACK_S = 0.1
_MARGIN = 0.03, 0.015, 0.008  # m, and shares of the depth and its square
_FRONT = 1.5  # log-odds of a segment that is all in front, by 1/30 s
_LEAST_FRONT = 0.1  # share of a segment that is more than its edges
_MIXED = 0.25  # with more of it in front, what agrees says nothing for the segment


class _Baseline(NamedTuple):
    """A time to look back, and what it is worth that nothing has changed since then."""

    ago_s: float
    rest: float  # log-odds, by 1/30 s: a slow thing is where it was for a while


_BASELINES = (
    _Baseline(0.17, 0.05),
    _Baseline(0.4, 0.1),
    _Baseline(1.0, 0.25),
    _Baseline(2.5, 0.4),
)


class _Past(NamedTuple):
    """A depth image of earlier."""

    stamp_s: float
    T_camera_world: FloatArray
    range_m: Float32Array  # (h, w, 2) least and most depth around each pixel


class PastViews:
    """Depth images of the last seconds, and the evidence that they give."""

    def __init__(self, camera: SmallCamera) -> None:
        self._camera = camera
        self._views: list[_Past] = []

    def remember(self, view: SmallView, T_world_camera: FloatArray) -> None:
        """Keep a view as long as one will want to look back to it."""
        if self._views and view.stamp_s - self._views[-1].stamp_s < _STEP_S:
            return
        range_m = depths_around(view.depth_m)
        self._views.append(_Past(view.stamp_s, se3.inverse(T_world_camera), range_m))
        oldest_s = view.stamp_s - _BASELINES[-1].ago_s * (1 + _SLACK)
        while self._views[0].stamp_s < oldest_s:
            del self._views[0]

    def evidence(self, view: SmallView, T_world_camera: FloatArray) -> FloatArray:
        """Return the (S,) log-odds of 1/30 s that each segment of a view moves.

        What is in front of what was seen earlier has come there. What is behind it was hidden then
        or has been there: that says nothing.
        """
        earlier = [
            (past.T_camera_world @ T_world_camera, past.range_m, baseline.rest)
            for baseline in _BASELINES
            if (past := self._at(view.stamp_s, baseline.ago_s)) is not None
        ]
        return front_evidence(
            self._camera.depth_pinhole,
            view.depth_m,
            view.segments.label,
            len(view.segments.region),
            earlier,
            _MARGIN,
            (_FRONT, _LEAST_FRONT, _MIXED),
        )

    def _at(self, now_s: float, ago_s: float) -> _Past | None:
        """Return the view of about so long ago, if there is one."""
        if not self._views:
            return None
        slack_s = max(_SLACK * ago_s, _LEAST_SLACK_S)
        wanted_s = now_s - ago_s
        n = bisect_left(self._views, wanted_s, key=lambda past: past.stamp_s)
        beside = [self._views[k] for k in (n - 1, n) if 0 <= k < len(self._views)]
        best = min(beside, key=lambda past: abs(past.stamp_s - wanted_s))
        return best if abs(best.stamp_s - wanted_s) <= slack_s else None
