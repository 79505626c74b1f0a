"""Points followed over images, each with the place in the world where it was seen first."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, Float32Array, FloatArray
from hoid_filter.motion.small_camera import SmallCamera
from hoid_filter.motion.small_view import FLOW_LEVELS
from hoid_native import FlowPyramid, FlowSearch, follow_points

_SEARCH = FlowSearch(
    num_levels=FLOW_LEVELS,
    back_levels=FLOW_LEVELS - 1,  # it is known about where to
    num_steps=8,
    least_step_px=0.03,
    margin_px=3.0,
    return_px=0.5,
)
_MAX_STEP_PX = 40.0  # that is expected from one image to the next


@dataclass(frozen=True, eq=False)
class PointTracks:
    """N points in the small grey image, and where they were when they were anchored."""

    uv_px: Float32Array  # (N, 2) in the grey image
    anchor_m: FloatArray  # (N, 3) in the world
    anchored_s: FloatArray  # (N,) when
    renew_s: FloatArray  # (N,) when they are to be anchored anew
    depth_m: FloatArray  # (N,) where they were last, as far as it is known

    @staticmethod
    def none() -> PointTracks:
        """Return no points."""
        empty = np.empty(0)
        return PointTracks(np.empty((0, 2), np.float32), np.empty((0, 3)), empty, empty, empty)

    def __len__(self) -> int:
        return len(self.anchored_s)

    def select(self, keep: BoolArray) -> PointTracks:
        """Return the points at a (N,) mask."""
        kept = np.flatnonzero(keep)
        return PointTracks(**{name: values.take(kept, 0) for name, values in vars(self).items()})

    def joined(self, other: PointTracks) -> PointTracks:
        """Return these points and the others."""
        mine, theirs = vars(self), vars(other)
        return PointTracks(**{n: np.concatenate([mine[n], theirs[n]]) for n in mine})

    def anchored_anew(
        self, due: BoolArray, points_world_m: FloatArray, now_s: float, for_s: float
    ) -> PointTracks:
        """Return the tracks with (N,) those that are due anchored where they are, (N, 3), now."""
        return dataclasses.replace(
            self,
            anchor_m=np.where(due[:, None], points_world_m, self.anchor_m),
            anchored_s=np.where(due, now_s, self.anchored_s),
            renew_s=np.where(due, now_s + for_s, self.renew_s),
        )


def expected_px(
    tracks: PointTracks, T_camera_world: FloatArray, T_next_world: FloatArray, camera: SmallCamera
) -> Float32Array:
    """Return where the points go if they rest and the camera moves on to the next pose."""
    focal_px = camera.gray_pinhole.fx_px, camera.gray_pinhole.fy_px
    before, after = (
        _on_plane(se3.transform(T, tracks.anchor_m)) for T in (T_camera_world, T_next_world)
    )
    step_px = (after - before) * focal_px
    limited_px = np.minimum(np.maximum(step_px, -_MAX_STEP_PX), _MAX_STEP_PX)
    return tracks.uv_px + limited_px.astype(np.float32)


def _on_plane(points_m: FloatArray) -> FloatArray:
    on_plane: FloatArray = points_m[:, :2] / np.maximum(points_m[:, 2:], 0.05)
    return on_plane


def follow(
    before: FlowPyramid, now: FlowPyramid, tracks: PointTracks, guess_px: Float32Array
) -> tuple[PointTracks, BoolArray]:
    """Return the points found again in the grey image of now, and which of the (N,) they are."""
    uv_px, found = follow_points(before, now, tracks.uv_px, guess_px, _SEARCH)
    return dataclasses.replace(tracks, uv_px=uv_px).select(found), found
