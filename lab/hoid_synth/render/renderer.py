"""Renders single frames of a stage: rays, shading, shadows, motion blur, sensor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.values import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from hoid_synth.acting.stage import Stage
from hoid_synth.config import FLOOR
from hoid_synth.mesh import Mesh
from hoid_synth.render import lighting, sensor, shading
from hoid_synth.render.tracer import Hits, Tracer

_COARSE = 2  # shadows and image motion are computed on every second pixel
_SHADOW_DEPTH = 0.55  # share of the light that a full shadow removes
_SHADOW_REACH_M = 1.8
_MARGIN_PX = 2


@dataclass(frozen=True, eq=False)
class Rendering:
    """One frame: the images of the camera, and the ground truth of each pixel."""

    image_bgr: ByteArray  # (H, W, 3)
    depth_m: Float32Array  # (H, W), with the errors of the sensor
    true_depth_m: Float32Array  # (H, W)
    instances: ByteArray  # (H, W)


@dataclass(frozen=True, eq=False)
class _View:
    """A camera pose and the rays of its pixels."""

    T_world_camera: FloatArray  # (4, 4) of the middle of the image
    origins_m: Float32Array  # (1, 3), or (N, 3) with a rolling shutter
    directions: Float32Array  # (N, 3) in the world frame, scaled to depth 1

    def at(self, pixels: IntArray) -> tuple[Float32Array, Float32Array]:
        """Return origins and directions of the rays of some pixels."""
        is_common = len(self.origins_m) == 1
        return self.origins_m if is_common else self.origins_m[pixels], self.directions[pixels]


@dataclass(frozen=True, eq=False)
class _Moving:
    """Meshes that move, in one frame."""

    mesh: Mesh
    tracer: Tracer
    normals: Float32Array  # (F, 3)
    steps_m: Float32Array  # (V, 3) motion of each vertex to the next frame


class Renderer:
    """Renders the frames of a stage, independently of each other."""

    def __init__(self, stage: Stage) -> None:
        config, camera, mesh = stage.config, stage.config.camera, stage.static_mesh
        self._stage, self._config = stage, config
        self._tracer = Tracer(mesh.vertices_m, mesh.faces)
        light = lighting.bake(self._tracer, mesh, stage.world.lamps)
        self._table = shading.face_table(mesh, light, stage.world.atlas)
        self._normals = shading.face_normals(mesh)
        self._num_static = len(mesh.faces)
        self._texture, self._instance = mesh.texture, mesh.instance
        self._moving_mesh = lru_cache(4)(stage.moving_mesh)
        first = self._moving_mesh(0)
        if first is not None:
            dark = np.zeros(len(first.vertices_m), np.float32)
            moving = shading.face_table(first, dark, stage.world.atlas)
            self._table = np.concatenate([self._table, moving])
            self._texture = np.concatenate([mesh.texture, first.texture])
            self._instance = np.concatenate([mesh.instance, first.instance])
        self._shape = (config.height_px, config.width_px)
        v, u = np.mgrid[0 : config.height_px, 0 : config.width_px]
        rays = (
            (u - camera.cx_px) / camera.fx_px,
            (v - camera.cy_px) / camera.fy_px,
            np.ones(self._shape),
        )
        self._rays = np.stack(rays, -1).reshape(-1, 3).astype(np.float32)
        self._ray_lengths = np.linalg.norm(self._rays, axis=1)
        self._exposure_phases = np.random.default_rng([config.seed, 5]).uniform(0, 2 * np.pi, 2)

    def render(self, i: int) -> Rendering:
        """Render frame i."""
        rng = np.random.default_rng([self._config.seed, 6, i])
        view = self._view(i)
        hits = self._tracer.first_hits(view.origins_m, view.directions)
        moving = self._prepare_moving(i)
        if moving is not None:
            self._overlay(hits, moving, view)
        cosine = self._cosine(hits, moving, view)
        footprint = hits.t**2 / (cosine * np.float32(self._config.camera.fx_px**2))
        color = shading.shade(
            self._table,
            hits,
            footprint,
            self._stage.world.atlas,
            self._shadow(hits, moving, view),
            self._exposure(i),
        )
        flow = self._flow(i, hits, moving)
        texture = self._texture[hits.face]
        depth = hits.t.reshape(self._shape)
        dark = self._stage.world.atlas.ir_dark[texture].reshape(self._shape)
        image = sensor.color_image(color.reshape(*self._shape, 3), flow, self._config, rng)
        read = sensor.depth_image(depth, cosine.reshape(self._shape), dark, self._config, rng)
        return Rendering(image, read, depth, self._instance[hits.face].reshape(self._shape))

    def _view(self, i: int) -> _View:
        """Return the rays of frame i; a rolling shutter has a camera pose for each row."""
        T = self._stage.T_world_camera[i]
        if not self._config.shutter_s:
            rotation, origin = T[:3, :3].astype(np.float32), T[:3, 3].astype(np.float32)
            return _View(T, origin[None], self._rays @ rotation.T)
        height, width = self._shape
        after_s = self._config.shutter_s * ((np.arange(height) + 0.5) / height - 0.5)
        rows = T @ se3.exp(after_s[:, None] * self._stage.velocity(i))
        rays = self._rays.reshape(height, width, 3)
        directions = rays @ rows[:, :3, :3].swapaxes(1, 2).astype(np.float32)
        origins = np.repeat(rows[:, :3, 3].astype(np.float32), width, axis=0)
        return _View(T, origins, directions.reshape(-1, 3))

    def _prepare_moving(self, i: int) -> _Moving | None:
        mesh, after = self._moving_mesh(i), self._moving_mesh(i + 1)
        if mesh is None or after is None:
            return None
        light = lighting.light_moving(self._tracer, mesh, self._stage.world.lamps)
        shading.set_light(self._table[self._num_static :], mesh, light)
        steps = after.vertices_m - mesh.vertices_m
        return _Moving(
            mesh, Tracer(mesh.vertices_m, mesh.faces), shading.face_normals(mesh), steps
        )

    def _overlay(self, hits: Hits, moving: _Moving, view: _View) -> None:
        """Replace the hits that lie behind moving meshes."""
        pixels = np.flatnonzero(self._may_show(moving.mesh, view))
        if len(pixels) == 0:
            return
        front = moving.tracer.first_hits(*view.at(pixels))
        nearer = front.t < hits.t[pixels]
        at = pixels[nearer]
        hits.t[at] = front.t[nearer]
        hits.face[at] = front.face[nearer] + self._num_static
        hits.barycentric[at] = front.barycentric[nearer]

    def _may_show(self, mesh: Mesh, view: _View) -> BoolArray:
        """Return a mask (N,) of the pixels inside the bounding boxes of moving instances."""
        mask = np.zeros(self._shape, bool)
        camera, T_camera_world = self._config.camera, se3.inverse(view.T_world_camera)
        points = se3.transform(T_camera_world, mesh.vertices_m.astype(float))
        for instance in np.unique(mesh.instance):
            own = points[np.unique(mesh.faces[mesh.instance == instance])]
            if own[:, 2].max() < 0.05:
                continue
            if own[:, 2].min() < 0.05:  # reaches behind the camera, so that no bounding box exists
                return np.ones(mask.size, bool)
            u = camera.fx_px * own[:, 0] / own[:, 2] + camera.cx_px
            v = camera.fy_px * own[:, 1] / own[:, 2] + camera.cy_px
            low = np.maximum([v.min() - _MARGIN_PX, u.min() - _MARGIN_PX], 0).astype(int)
            high = np.maximum([v.max() + _MARGIN_PX + 1, u.max() + _MARGIN_PX + 1], 0).astype(int)
            mask[low[0] : high[0], low[1] : high[1]] = True
        return mask.ravel()

    def _cosine(self, hits: Hits, moving: _Moving | None, view: _View) -> Float32Array:
        normals = (
            self._normals if moving is None else np.concatenate([self._normals, moving.normals])
        )
        along = np.einsum('ij,ij->i', np.take(normals, hits.face, axis=0), view.directions)
        return np.asarray(np.maximum(np.abs(along) / self._ray_lengths, 1e-3), np.float32)

    def _exposure(self, i: int) -> float:
        """Return the gain of frame i, which varies slowly as with automatic exposure."""
        waves = np.sin(
            2 * np.pi * self._config.time_s(i) * np.array([0.13, 0.31]) + self._exposure_phases
        )
        return float(1.15 * (1 + self._config.exposure_swing * waves.sum()))

    def _coarse(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the values (N, ...) of every second pixel in every second row."""
        rest = values.shape[1:]
        return values.reshape(*self._shape, *rest)[::_COARSE, ::_COARSE].reshape(-1, *rest)

    def _fine(self, coarse: NDArray[Any]) -> Float32Array:
        """Return values (H, W, ...) interpolated from coarse ones."""
        shape = [-(-n // _COARSE) for n in self._shape]
        image = coarse.reshape(*shape, *coarse.shape[1:])
        return np.asarray(cv2.resize(image, self._shape[::-1]), np.float32)

    def _shadow(self, hits: Hits, moving: _Moving | None, view: _View) -> Float32Array:
        """Return the share (N,) of light that remains in the shadows of moving meshes."""
        if moving is None:
            return np.ones(len(hits.t), np.float32)
        t, face = self._coarse(hits.t), self._coarse(hits.face)
        origin = view.T_world_camera[:3, 3].astype(np.float32)
        own = view.origins_m if len(view.origins_m) == 1 else self._coarse(view.origins_m)
        points = own + t[:, None] * self._coarse(view.directions)
        left = np.ones(len(points), np.float32)
        resting = np.flatnonzero(face < self._num_static)
        near = resting[_near(points[resting, :2], moving.mesh)]
        origins = points[near] + np.float32(0.004) * (origin - points[near])
        lamps = [
            lamp.points_m.astype(np.float32)
            for lamp in self._stage.world.lamps
            if len(lamp.points_m) == lighting.CEILING_POINTS
        ]
        for lamp, lit in zip(lamps, self._lit(lamps, origins), strict=True):
            hidden = np.zeros(len(lit), np.float32)
            for point in lamp if len(lit) else ():
                hidden += moving.tracer.occluded(origins[lit], point - origins[lit])
            left[near[lit]] -= _SHADOW_DEPTH * hidden / lighting.CEILING_POINTS
        return np.asarray(cv2.blur(self._fine(left), (9, 9)), np.float32).ravel()

    def _lit(self, lamps: list[Float32Array], points_m: Float32Array) -> list[IntArray]:
        """Return for each lamp which points (N, 3) it shadows: on a floor, those nearest to it."""
        every = np.arange(len(points_m))
        if self._config.path != FLOOR:
            return [every] * len(lamps)
        middles = np.array([lamp.mean(0) for lamp in lamps])
        nearest = np.linalg.norm(points_m[:, None] - middles, axis=2).argmin(1)
        return [every[nearest == k] for k in range(len(lamps))]

    def _flow(self, i: int, hits: Hits, moving: _Moving | None) -> Float32Array:
        """Return the image motion (H, W, 2) during the exposure in px."""
        T = self._stage.T_world_camera[i]
        share = sensor.EXPOSURE_S * self._config.rate_hz * self._config.motion_blur
        twist = share * self._stage.twist(i)
        rays, t = self._coarse(self._rays), self._coarse(hits.t)
        points = rays * t[:, None]
        step = -(np.cross(twist[:3].astype(np.float32), points) + twist[3:].astype(np.float32))
        if moving is not None:
            face = self._coarse(hits.face) - self._num_static
            own = np.flatnonzero(face >= 0)
            weight = self._coarse(hits.barycentric)[own]
            corners = moving.steps_m[moving.mesh.faces[face[own]]]
            way = corners[:, 0] + weight[:, :1] * (corners[:, 1] - corners[:, 0])
            way += weight[:, 1:] * (corners[:, 2] - corners[:, 0])
            step[own] += np.float32(share) * way @ T[:3, :3].astype(np.float32)
        scale = np.float32(self._config.camera.fx_px) / t
        flow = (step[:, :2] - rays[:, :2] * step[:, 2:]) * scale[:, None]
        return self._fine(flow.astype(np.float32))


def _near(xy_m: Float32Array, mesh: Mesh) -> BoolArray:
    """Return a mask (N,) of the positions within reach of a moving instance's shadow."""
    near = np.zeros(len(xy_m), bool)
    for instance in np.unique(mesh.instance):
        own = mesh.vertices_m[mesh.faces[mesh.instance == instance, 0], :2]
        near |= (np.abs(xy_m - own.mean(0)) < _SHADOW_REACH_M).all(1)
    return near
