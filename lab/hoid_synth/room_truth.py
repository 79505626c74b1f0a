"""Ground truth for maps of a rendered recording, in the frame of its map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray
from hoid_synth.acting.stage import Stage, set_stage
from hoid_synth.config import SceneConfig
from hoid_synth.mesh import merged
from hoid_synth.static_model import StaticModel

_LEFT_ALONE_FRAMES = 60  # 2 s; the map may show an object at the place it left less than this ago
_PATH_RADIUS_M = 0.3
_PATH_FRAMES = 3  # of 30 per second; a person walks 12 cm in this time
_BODY_M = (0.1, 1.85)
_OBSTACLE_M = (0.1, 1.8)


class RoomTruth:
    """Static surfaces, paths of people and occupancy of a rendered recording.

    Args:
        config: Configuration of the recording.
        T_map_camera: (4, 4) pose of the first camera in the map frame.
    """

    def __init__(self, config: SceneConfig, T_map_camera: FloatArray) -> None:
        self.stage = set_stage(config)
        resting = _with_resting_objects(self.stage)
        self._model = StaticModel(resting)
        self._mesh = resting.static_mesh
        self.T_world_map = self.stage.T_world_camera[0] @ se3.inverse(T_map_camera)

    def distance_m(self, points_map_m: FloatArray) -> FloatArray:
        """Return distances (N,) of points (N, 3) to static surfaces, limited to 6 cm."""
        return self._model.distance_m(se3.transform(self.T_world_map, points_map_m))

    def on_paths(self, points_map_m: FloatArray) -> BoolArray:
        """Return whether (N,) points (N, 3) are where people walked and no static surface is."""
        points = se3.transform(self.T_world_map, points_map_m)
        if not self.stage.bodies:
            return np.zeros(len(points), np.bool_)
        step = max(_PATH_FRAMES // self.stage.config.every, 1)
        paths = cKDTree(np.concatenate([body.xy_m[::step] for body in self.stage.bodies]))
        gap, _ = paths.query(points[:, :2], distance_upper_bound=_PATH_RADIUS_M)
        body = (points[:, 2] > _BODY_M[0]) & (points[:, 2] < _BODY_M[1]) & (gap < _PATH_RADIUS_M)
        return np.asarray(body & (self.distance_m(points_map_m) > 0.05))

    def occupied(
        self, T_map_origin: FloatArray, shape: tuple[int, int], resolution_m: float
    ) -> BoolArray:
        """Return the true occupancy (H, W) of a grid, by surfaces 0.1 to 1.8 m above the floor."""
        corners = self._mesh.vertices_m[self._mesh.faces].astype(float)
        z = corners[:, :, 2]
        is_obstacle = (z.max(1) > _OBSTACLE_M[0]) & (z.min(1) < _OBSTACLE_M[1])
        points = _samples(corners[is_obstacle], 0.01)
        points = points[(points[:, 2] > _OBSTACLE_M[0]) & (points[:, 2] < _OBSTACLE_M[1])]
        local = se3.transform(se3.inverse(self.T_world_map @ T_map_origin), points)
        cell = np.floor(local[:, :2] / resolution_m).astype(int)
        inside = ((cell >= 0) & (cell < shape[::-1])).all(axis=1)
        out = np.zeros(shape, bool)
        out[cell[inside, 1], cell[inside, 0]] = True
        return out


def _with_resting_objects(stage: Stage) -> Stage:
    """Return a stage whose static mesh includes handled objects at their last resting place."""
    end, meshes = stage.config.frames, [stage.world.static]
    for placed, track in zip(stage.world.props, stage.objects, strict=True):
        late = np.flatnonzero(~track.handled[:end])
        late = late[late >= end - _LEFT_ALONE_FRAMES]
        if track.handled.any() and len(late):
            poses = track.T_world_object[[late[0], late[-1]]]
            meshes += [placed.prop.mesh.transformed(T) for T in poses]
    return replace(stage, world=replace(stage.world, static=merged(meshes)))


def _samples(corners: FloatArray, spacing_m: float) -> FloatArray:
    """Return random points (N, 3) on triangles (F, 3, 3), about `spacing_m` apart."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    face = np.repeat(np.arange(len(a)), np.ceil(area / spacing_m**2).astype(int))
    s, t = np.random.default_rng(0).random((2, len(face), 1))
    s, t = np.where(s + t > 1, (1 - s, 1 - t), (s, t))
    return np.asarray(a[face] + s * (b - a)[face] + t * (c - a)[face])
