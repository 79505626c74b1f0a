"""Depth images of the last seconds: surfaces that are now in front of them have moved."""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common import se3
from hoid_common.values import Float32Array, FloatArray
from hoid_filter.motion.downscaled_camera import DownscaledCamera, DownscaledView, rays_of
from hoid_native import occlusion_log_odds

# Chosen: least time between stored images, so that each image of a 30 Hz camera is stored, and
# every other one of a 60 Hz camera.
_MIN_SPACING_S = 1 / 40
# Chosen: the age of an image may differ from the wanted age by 30 %, and always by 0.1 s, so that
# at low frame rates an image of the shortest age exists.
_AGE_TOLERANCE, _MIN_AGE_TOLERANCE_S = 0.3, 0.1
# A point is in front of earlier depth z if it is nearer by more than 0.03 m + 1.5 % z + 0.8 % z^2.
# Chosen: well above the error of the poses and depth noise, which grows with the square of depth.
_OCCLUSION_MARGIN = 0.03, 0.015, 0.008
# Chosen: a segment that is completely in front is certainly moving after 2 images.
_OCCLUSION_LOG_ODDS = 1.5
# Chosen: if a smaller ratio of a segment is in front, only its depth edges are.
_MIN_OCCLUDING_RATIO = 0.1
# Chosen: if a larger ratio of a segment is in front, the unchanged depth of its other pixels is no
# evidence that it is static.
_MIXED_RATIO = 0.25
# The readout time of a rolling shutter, which the filter does not know for its camera. Chosen:
# that of a Kinect, 30.6 ms (Ringaby and Forssen, ICCV 2011). While a camera turns slowly, the
# shift of the image rows is below the other tolerances.
_READOUT_S = 0.03
# Smaller rolling-shutter shifts count as 0: 6 sigmas of 0.25 px. The measured noise contains them
# already; counting them twice would hide slowly moving surfaces (decision 050).
_MIN_SHIFT_PX = 1.5


class _Baseline(NamedTuple):
    """The age of an earlier depth image for comparison, and the evidence of unchanged depth."""

    age_s: float
    static_log_odds: float  # log-odds against motion when the depth is unchanged


# Chosen: ages that at least double, so that fast and slow objects are found. In a trial, objects
# at 1/8 of walking speed were found only with an age of 2 to 3 s. A slow object still overlaps its
# position of 0.2 s ago, so that unchanged depth is weak evidence at short ages.
_BASELINES = (
    _Baseline(0.17, 0.05),
    _Baseline(0.4, 0.1),
    _Baseline(1.0, 0.25),
    _Baseline(2.5, 0.4),
)


# Chosen, of the ages above: long enough to reveal motion, and short enough that most of the image
# is still in view.
_COMPARED_BASELINES = _BASELINES[1:3]
_STEP_PX = 2  # chosen: every second row and column of the downscaled depth, for speed


class _PastDepth(NamedTuple):
    """An earlier depth image, as a range around each pixel, and the camera pose."""

    stamp_s: float
    T_camera_world: FloatArray  # (4, 4)
    turn_radps: FloatArray  # (3,) turn rate of the camera
    range_m: Float32Array  # (h, w, 2) least and greatest depth in the 3x3 neighborhood


class DepthHistory:
    """The depth images of the last 3.25 s, with camera poses in the first camera's frame."""

    def __init__(self, camera: DownscaledCamera) -> None:
        self._camera = camera
        self._past: list[_PastDepth] = []
        height, width = camera.shape_hw
        v, u = np.mgrid[:height:_STEP_PX, :width:_STEP_PX]
        # (M, 3) rays of the compared pixels, with z = 1
        self._rays = rays_of(camera.depth_pinhole, u.ravel(), v.ravel())

    def add(
        self, view: DownscaledView, T_world_camera: FloatArray, turn_radps: FloatArray
    ) -> None:
        """Store the depth of a view, and drop depth images that are older by more than 3.25 s."""
        if self._past and view.stamp_s - self._past[-1].stamp_s < _MIN_SPACING_S:
            return
        range_m = widened(np.stack([view.depth_m, view.depth_m], axis=2), 1)
        T_camera_world = se3.inverse(T_world_camera)
        self._past.append(_PastDepth(view.stamp_s, T_camera_world, turn_radps, range_m))
        oldest_s = view.stamp_s - _BASELINES[-1].age_s * (1 + _AGE_TOLERANCE)
        while self._past[0].stamp_s < oldest_s:
            del self._past[0]

    def occlusion_evidence(
        self, view: DownscaledView, T_world_camera: FloatArray, turn_radps: FloatArray
    ) -> FloatArray:
        """Return the log-odds (S,) that each depth segment moves, per `EVIDENCE_PERIOD_S`.

        A surface in front of the depth of an earlier image has moved. Unchanged depth is evidence
        against motion. A surface behind the earlier depth is no evidence: it may have been hidden.
        """
        focal_px = self._camera.depth_pinhole.fx_px
        earlier = [
            (
                past.T_camera_world @ T_world_camera,
                widened(past.range_m, shift_px(turn_radps, past.turn_radps, focal_px)),
                baseline.static_log_odds,
            )
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
            (_OCCLUSION_LOG_ODDS, _MIN_OCCLUDING_RATIO, _MIXED_RATIO),
        )

    def contradiction(self, view: DownscaledView, T_world_camera: FloatArray) -> float:
        """Return the ratio of the view's pixels that contradict earlier depth at a pose (4, 4).

        They would be in front of it. At the right pose the ratio is 0 if nothing moves. It is the
        mean over the images 0.4 s and 1 s earlier, or 0 without such an image.
        """
        depth_m = view.depth_m[::_STEP_PX, ::_STEP_PX].ravel()
        points_m = self._rays[depth_m > 0] * depth_m[depth_m > 0, None].astype(np.float64)
        world_m = se3.transform(T_world_camera, points_m)
        ratios = [
            self._ratio_in_front(past, se3.transform(past.T_camera_world, world_m))
            for baseline in _COMPARED_BASELINES
            if (past := self._nearest(view.stamp_s, baseline.age_s)) is not None
        ]
        return float(np.mean(ratios)) if ratios else 0.0

    def _ratio_in_front(self, past: _PastDepth, points_m: FloatArray) -> float:
        """Return the ratio of points (N, 3), in a past camera's frame, in front of its depth."""
        pinhole, (height, width) = self._camera.depth_pinhole, self._camera.shape_hw
        x, y, z = points_m[points_m[:, 2] > 0].T
        u = np.rint(x / z * pinhole.fx_px + pinhole.cx_px)
        v = np.rint(y / z * pinhole.fy_px + pinhole.cy_px)
        inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
        row, column, z = v[inside].astype(np.int64), u[inside].astype(np.int64), z[inside]
        nearest_m = past.range_m[row, column, 0]
        constant_m, per_m, per_m2 = _OCCLUSION_MARGIN
        is_in_front = z < nearest_m - (constant_m + per_m * z + per_m2 * z**2)
        is_known = nearest_m > 0
        num_known = int(np.count_nonzero(is_known))
        return int(np.count_nonzero(is_in_front & is_known)) / max(num_known, 1)

    def _nearest(self, now_s: float, age_s: float) -> _PastDepth | None:
        if not self._past:
            return None
        tolerance_s = max(_AGE_TOLERANCE * age_s, _MIN_AGE_TOLERANCE_S)
        wanted_s = now_s - age_s
        n = bisect_left(self._past, wanted_s, key=lambda past: past.stamp_s)
        neighbors = [self._past[k] for k in (n - 1, n) if 0 <= k < len(self._past)]
        best = min(neighbors, key=lambda past: abs(past.stamp_s - wanted_s))
        return best if abs(best.stamp_s - wanted_s) <= tolerance_s else None


def widened(range_m: Float32Array, by_px: FloatArray | float) -> Float32Array:
    """Return depth ranges (h, w, 2), each over a neighborhood larger by `by_px` on all sides."""
    side = 2 * round(float(by_px)) + 1
    if side == 1:
        return range_m
    kernel = np.ones((side, side), np.uint8)
    least_m, greatest_m = np.moveaxis(range_m, 2, 0)
    is_known = greatest_m > 0
    nearest_m = cv2.erode(np.where(is_known, least_m, np.float32(np.inf)), kernel)
    farthest_m = cv2.dilate(np.ascontiguousarray(greatest_m), kernel)
    widened_m = np.stack([nearest_m, farthest_m], axis=2)
    widened_m[~is_known] = 0
    return np.asarray(widened_m, np.float32)


def shift_px(turn_radps: FloatArray, earlier_radps: FloatArray, focal_px: float) -> FloatArray:
    """Return the largest rolling-shutter shift (px) of an image row relative to the middle row.

    Turn rates are (..., 3). A shift below 1.5 px counts as 0, because the measured noise contains
    it.
    """
    change_radps = np.linalg.norm(turn_radps - earlier_radps, axis=-1)
    shift_px = 0.5 * _READOUT_S * focal_px * change_radps
    return np.where(shift_px < _MIN_SHIFT_PX, 0.0, shift_px)
