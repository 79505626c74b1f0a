"""Points tracked by optical flow, each with an anchor: its earlier position in the world."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import cv2
import numpy as np

from hoid_common import se3
from hoid_common.io.depth import MIN_DEPTH_M
from hoid_common.values import BoolArray, ByteArray, Float32Array, FloatArray
from hoid_filter.motion.downscaled_camera import DownscaledCamera

# Lucas-Kanade optical flow (IJCAI 1981). It starts at a predicted pixel, so that few iterations
# suffice. Chosen: on the coarsest of 3 levels, the 9 px window covers 16 px to each side. Backward
# tracking starts near its result and needs only 2 levels.
_WINDOW_PX = 9
_MAX_LEVEL, _MAX_LEVEL_BACK = 2, 1
# At most 8 iterations; ends at steps below 0.03 px.
_STOP_AT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 8, 0.03)
# With the flag for eigenvalues, OpenCV skips the computation of an error that is not used here.
_FLAGS = cv2.OPTFLOW_USE_INITIAL_FLOW | cv2.OPTFLOW_LK_GET_MIN_EIGENVALS
_MAX_RETURN_ERROR_PX = 0.5  # chosen: largest error after tracking forward and backward
# Chosen: points nearer to the border are dropped, as most of their window is outside.
_MARGIN_PX = 3.0
# Chosen: limit of the predicted motion, 1/8 of the image, in case the prediction is wrong.
_MAX_PREDICTED_PX = 40.0


@dataclass(frozen=True, eq=False)
class PointTracks:
    """N tracked points: their pixels in the newest gray image, and their earlier positions."""

    uv_px: Float32Array  # (N, 2) in the downscaled gray image
    anchor_m: FloatArray  # (N, 3) anchor: world position of the point at the time `anchored_s`
    anchored_s: FloatArray  # (N,) time of the anchor
    anchored_radps: FloatArray  # (N, 3) turn rate of the camera at that time
    renew_s: FloatArray  # (N,) time at which the anchor must be renewed
    depth_m: FloatArray  # (N,) last known depth

    @staticmethod
    def none() -> PointTracks:
        empty = np.empty(0)
        three = np.empty((0, 3))
        return PointTracks(np.empty((0, 2), np.float32), three, empty, three, empty, empty)

    def __len__(self) -> int:
        return len(self.anchored_s)

    def select(self, mask: BoolArray) -> PointTracks:
        index = np.flatnonzero(mask)
        return PointTracks(**{name: values.take(index, 0) for name, values in vars(self).items()})

    def concatenate(self, other: PointTracks) -> PointTracks:
        mine, theirs = vars(self), vars(other)
        return PointTracks(**{n: np.concatenate([mine[n], theirs[n]]) for n in mine})

    def anchor(
        self,
        mask: BoolArray,
        points_world_m: FloatArray,
        turn_radps: FloatArray,
        now_s: float,
        for_s: float,
    ) -> PointTracks:
        """Return the tracks with new anchors (N, 3), in the world, where `mask` (N,) is True."""
        return dataclasses.replace(
            self,
            anchor_m=np.where(mask[:, None], points_world_m, self.anchor_m),
            anchored_s=np.where(mask, now_s, self.anchored_s),
            anchored_radps=np.where(mask[:, None], turn_radps, self.anchored_radps),
            renew_s=np.where(mask, now_s + for_s, self.renew_s),
        )


def predict_px(
    tracks: PointTracks,
    T_camera_world: FloatArray,
    T_next_world: FloatArray,
    camera: DownscaledCamera,
) -> Float32Array:
    """Return pixels (N, 2) predicted for static points, at most 40 px from the present ones."""
    focal_px = camera.gray_pinhole.fx_px, camera.gray_pinhole.fy_px
    before, after = (
        _normalized(se3.transform(T, tracks.anchor_m)) for T in (T_camera_world, T_next_world)
    )
    flow_px = (after - before) * focal_px
    # np.clip takes three times as long.
    clipped_px = np.minimum(np.maximum(flow_px, -_MAX_PREDICTED_PX), _MAX_PREDICTED_PX)
    return tracks.uv_px + clipped_px.astype(np.float32)


def _normalized(points_m: FloatArray) -> FloatArray:
    normalized: FloatArray = points_m[:, :2] / np.maximum(points_m[:, 2:], MIN_DEPTH_M)
    return normalized


def track(
    previous: ByteArray, current: ByteArray, tracks: PointTracks, predicted_px: Float32Array
) -> tuple[PointTracks, BoolArray]:
    """Return the points found again in the current image, and the mask (N,) of found points.

    A point is found if optical flow from `predicted_px` (N, 2) ends at least 3 px inside the
    image, and tracking it back ends within 0.5 px of its start.
    """
    if not len(tracks):
        return tracks, np.empty(0, np.bool_)
    uv_px, found = _optical_flow(previous, current, tracks.uv_px, predicted_px, _MAX_LEVEL)
    start_px = uv_px - (predicted_px - tracks.uv_px)
    back_px, returned = _optical_flow(current, previous, uv_px, start_px, _MAX_LEVEL_BACK)
    limit_px = np.array(current.shape[::-1], np.float32) - 1 - _MARGIN_PX
    inside = ((uv_px >= _MARGIN_PX) & (uv_px <= limit_px)).all(axis=1)
    error_px = np.abs(back_px - tracks.uv_px).max(axis=1)
    found &= returned & inside & (error_px < _MAX_RETURN_ERROR_PX)
    return dataclasses.replace(tracks, uv_px=uv_px).select(found), found


def _optical_flow(
    previous: ByteArray,
    current: ByteArray,
    from_px: Float32Array,
    start_px: Float32Array,
    max_level: int,
) -> tuple[Float32Array, BoolArray]:
    """Return the pixels (N, 2) of points in the current image, and flags (N,) of found points."""
    uv_px, found, _ = cv2.calcOpticalFlowPyrLK(
        previous,
        current,
        from_px,
        start_px.copy(),
        winSize=(_WINDOW_PX, _WINDOW_PX),
        maxLevel=max_level,
        criteria=_STOP_AT,
        flags=_FLAGS,
    )
    return np.asarray(uv_px, np.float32), found.ravel() > 0
