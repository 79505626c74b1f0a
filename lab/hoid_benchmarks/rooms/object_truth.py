"""The true objects of a rendered room: their whole boxes, and the part of each that was seen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_benchmarks.rooms.placed_box import PlacedBox, least_area_axes
from hoid_common import se3
from hoid_common.values import PERSON, FloatArray, IntArray
from hoid_synth.acting.stage import Stage
from hoid_synth.mesh import Mesh, merged
from hoid_synth.render.tracer import Tracer
from hoid_synth.room_truth import RoomTruth

_EVERY = 3  # frames; ten images per second are compared
_STRIDE = 4  # pixels between the rays
_RANGE_M = 5.0  # objects farther away are not expected to be found
_EXPECTED_PX, _EXPECTED_FRAMES = 400, 30  # an expected object shows so much of itself so long
_PERCENTILES = (1, 99)  # of the points of the seen part


class TrueObject(NamedTuple):
    """An object at its place at the end, in the map frame."""

    class_name: str
    whole: PlacedBox  # the upright box with the least footprint around the whole object
    seen: PlacedBox  # the box along the same axes around the part that the images showed
    seen_m: FloatArray  # (N, 3) points of this part
    is_expected: bool  # shown large, near and long enough to be found
    was_carried: bool
    instance: int = 0  # of the object in the world


def true_objects(truth: RoomTruth) -> list[TrueObject]:
    """Return the objects that were visible at their last place, people left out."""
    stage = truth.stage
    meshes, since = _resting(stage)
    points, frames = _seen_points(stage, merged(list(meshes.values())), since)
    T_map_world = se3.inverse(truth.T_world_map)
    out = []
    for instance, mesh in meshes.items():
        name = stage.world.class_names[instance]
        if instance not in points or name in ('', PERSON):
            continue
        used = mesh.vertices_m[np.unique(mesh.faces)].astype(np.float64)
        T_world_axes = least_area_axes(used)
        T_map_axes = T_map_world @ T_world_axes
        along, seen_along = (
            se3.transform(se3.inverse(T_world_axes), p) for p in (used, points[instance])
        )
        low, high = np.percentile(seen_along, _PERCENTILES, axis=0)
        out.append(
            TrueObject(
                name,
                PlacedBox.around(along.min(0), along.max(0), T_map_axes),
                PlacedBox.around(low, high, T_map_axes),
                se3.transform(T_map_world, points[instance]),
                is_expected=frames[instance] * _EVERY >= _EXPECTED_FRAMES,
                was_carried=since[instance] > 0,
                instance=instance,
            )
        )
    return out


def _resting(stage: Stage) -> tuple[dict[int, Mesh], IntArray]:
    """Return the mesh of each instance at its last place, and the first frame (I,) there.

    Instance 0 is the background. Objects that are in somebody's hands at the end are left out.
    """
    end = stage.config.frames
    static = stage.static_mesh
    meshes = {int(k): _part(static, int(k)) for k in np.unique(static.instance)}
    since = np.zeros(len(stage.world.class_names), np.int64)
    for placed, track in zip(stage.world.props, stage.objects, strict=True):
        handled = np.flatnonzero(track.handled[:end])
        if len(handled) and handled[-1] < end - 1:
            since[placed.instance] = handled[-1] + 1
            mesh = placed.prop.mesh.as_instance(placed.instance)
            meshes[placed.instance] = mesh.transformed(track.T_world_object[end - 1])
    return meshes, since


def _part(mesh: Mesh, instance: int) -> Mesh:
    """Return a mesh with the faces of one instance only; all its vertices are kept."""
    kept = mesh.instance == instance
    return Mesh(
        mesh.vertices_m,
        mesh.normals,
        mesh.uv,
        mesh.faces[kept],
        mesh.texture[kept],
        mesh.instance[kept],
    )


def _seen_points(
    stage: Stage, mesh: Mesh, since: IntArray
) -> tuple[dict[int, FloatArray], IntArray]:
    """Return the visible points (N, 3) of each instance, and in how many images it is large."""
    camera = stage.config.camera
    v, u = np.mgrid[0 : camera.height_px : _STRIDE, 0 : camera.width_px : _STRIDE]
    x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    tracer = Tracer(mesh.vertices_m, mesh.faces)
    least = _EXPECTED_PX * stage.config.scale**2 / _STRIDE**2
    parts: dict[int, list[FloatArray]] = {}
    frames = np.zeros(len(since), np.int64)
    for i in range(0, stage.config.frames, _EVERY):
        T = stage.T_world_camera[i]
        directions = (rays @ T[:3, :3].T).astype(np.float32)
        hits = tracer.first_hits(T[:3, 3], directions)
        moving = stage.moving_mesh(i)
        near = hits.t < _RANGE_M
        if moving is not None:
            others = Tracer(moving.vertices_m, moving.faces).first_hits(T[:3, 3], directions)
            near &= hits.t <= others.t + 1e-3
        rows = np.flatnonzero(near)
        instance = mesh.instance[hits.face[rows]].astype(np.int64)
        points = T[:3, 3] + hits.t[rows, None] * directions[rows]
        for k in np.unique(instance).tolist():
            if k > 0 and i >= since[k]:
                parts.setdefault(k, []).append(points[instance == k].astype(np.float64))
                frames[k] += np.count_nonzero(instance == k) >= least
    return {k: np.concatenate(found) for k, found in parts.items()}, frames
