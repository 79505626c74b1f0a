"""Remains in the dense map of an undetected person who stands still for 3 s and leaves."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from hoid_bringup.run.run_config import RunConfig
from hoid_common import se3
from hoid_common.values import DynamicObject, Float32Array, FloatArray, RgbdFrame
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.scene_scheduler import SceneRequest
from hoid_synth.room_truth import RoomTruth

_STAY_FRAMES, _AFTER_FRAMES = 90, 60  # 3 s and 2 s
_RADIUS_M, _HEIGHT_M = 0.2, 1.75
_DISTANCES_M = (1.8, 2.2, 2.6, 3.0)  # distances from the camera, tried in turn
_BEARINGS_RAD = (0.0, 0.15, -0.15, 0.3, -0.3)
# Heights on the person that must be visible all the time, and where points are counted.
_EVALUATED_M = (0.5, 1.5)
_MARGIN_PX = 4
_NEAR_M = 0.06
_SKIN_BGR = (90, 110, 140)


class Ghost:
    """Pastes a cylinder into the images of an empty room, and maps the room with them.

    Attributes:
        num_standing: Map points on the cylinder when it leaves; 0 if it found no free place.
        num_left: Map points at the cylinder's place 2 s after it left.
    """

    def __init__(self, truth: RoomTruth, config: RunConfig) -> None:
        self.num_standing = self.num_left = 0
        self._truth, scene = truth, truth.stage.config
        self._camera = scene.camera
        self._room = SceneMapper(scene.camera, config.scene.dense, config.scene.objects)
        self._frame_of = {scene.stamp_ns(i): i for i in range(scene.frames)}
        u, v = np.meshgrid(np.arange(scene.width_px), np.arange(scene.height_px))
        x, y = (u - self._camera.cx_px), (v - self._camera.cy_px)
        self._rays = np.stack(
            [x / self._camera.fx_px, y / self._camera.fy_px, np.ones(x.shape)], 2
        )
        self._first, self._xy_m = self._place()

    def fuse(
        self, pose: SceneRequest, frame: RgbdFrame, objects: tuple[DynamicObject, ...]
    ) -> None:
        """Fuse an image, with the cylinder in it for 3 s, and count the points when it leaves."""
        i = self._frame_of[frame.stamp_ns] - self._first
        if self._xy_m is None or i >= _STAY_FRAMES + _AFTER_FRAMES:
            return
        if 0 <= i < _STAY_FRAMES:
            frame = self._with_cylinder(frame, self._xy_m)
        self._room.fuse(pose, frame.depth_m, frame.image_bgr, objects)
        count = self._count(self._xy_m)
        if i < _STAY_FRAMES:
            self.num_standing = count
        else:
            self.num_left = count

    def _place(self) -> tuple[int, FloatArray | None]:
        """Return the first frame and the position (2,) of a place in full view, or None."""
        poses = self._truth.stage.T_world_camera
        span = _STAY_FRAMES + _AFTER_FRAMES
        for first in range(0, len(poses) - span, 15):
            middle = poses[first + span // 2]
            ahead = np.arctan2(middle[1, 2], middle[0, 2])
            for distance_m, bearing in product(_DISTANCES_M, _BEARINGS_RAD):
                angle = ahead + bearing
                xy_m = middle[:2, 3] + distance_m * np.array([np.cos(angle), np.sin(angle)])
                if self._is_free(xy_m) and self._is_seen(xy_m, first, span):
                    return first, xy_m
        return 0, None

    def _is_free(self, xy_m: FloatArray) -> bool:
        points = se3.transform(se3.inverse(self._truth.T_world_map), _surface_m(xy_m))
        return bool((self._truth.distance_m(points) >= _NEAR_M).all())

    def _is_seen(self, xy_m: FloatArray, first: int, span: int) -> bool:
        high_px = np.array([self._camera.width_px, self._camera.height_px]) - _MARGIN_PX
        points = _surface_m(xy_m)
        for T_world_camera in self._truth.stage.T_world_camera[first : first + span : 10]:
            seen = se3.transform(se3.inverse(T_world_camera), points)
            uv = self._camera.project_px(seen)
            if seen[:, 2].min() < 1.0 or (uv < _MARGIN_PX).any() or (uv > high_px).any():
                return False
        return True

    def _with_cylinder(self, frame: RgbdFrame, xy_m: FloatArray) -> RgbdFrame:
        T_world_camera = self._truth.stage.T_world_camera[self._frame_of[frame.stamp_ns]]
        body_m = cylinder_depth_m(self._rays, T_world_camera, xy_m)
        before = (body_m > 0) & ((frame.depth_m == 0) | (body_m < frame.depth_m))
        image = np.where(before[..., None], np.array(_SKIN_BGR, np.uint8), frame.image_bgr)
        return replace(frame, image_bgr=image, depth_m=np.where(before, body_m, frame.depth_m))

    def _count(self, xy_m: FloatArray) -> int:
        points = self._room.cloud().points_m.astype(np.float64)
        world = se3.transform(self._truth.T_world_map, points)
        height = (world[:, 2] > _EVALUATED_M[0]) & (world[:, 2] < _EVALUATED_M[1])
        near = np.linalg.norm(world[:, :2] - xy_m, axis=1) < _RADIUS_M + 0.05
        apart = self._truth.distance_m(points) > 0.05
        return int(np.count_nonzero(height & near & apart))


def _surface_m(xy_m: FloatArray) -> FloatArray:
    """Return points (N, 3) on the evaluated part of a cylinder at a place (2,)."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 16), np.linspace(*_EVALUATED_M, 8))
    around = np.stack([np.cos(angle), np.sin(angle)], axis=2) * _RADIUS_M + xy_m
    return np.concatenate([around, height[..., None]], axis=2).reshape(-1, 3)


def cylinder_depth_m(
    rays: FloatArray, T_world_camera: FloatArray, xy_m: FloatArray
) -> Float32Array:
    """Return the depth (H, W) of the cylinder along rays (H, W, 3) with z = 1; 0 where missed."""
    d = rays @ T_world_camera[:3, :3].T
    offset = T_world_camera[:2, 3] - xy_m
    a = d[..., 0] ** 2 + d[..., 1] ** 2
    b = d[..., :2] @ offset
    inside = b * b - a * (offset @ offset - _RADIUS_M**2)
    t = (-b - np.sqrt(np.maximum(inside, 0))) / a
    height = T_world_camera[2, 3] + t * d[..., 2]
    hit = (inside > 0) & (t > 0) & (height > 0) & (height < _HEIGHT_M)
    return np.where(hit, t, 0).astype(np.float32)
