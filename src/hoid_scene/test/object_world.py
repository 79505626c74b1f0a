"""Renders boxes on a floor into depth images, with their boxes as detections."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import (
    ByteArray,
    CameraModel,
    DynamicObject,
    Float32Array,
    FloatArray,
    ObjectState,
)
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.objects.object_map import ObjectMap
from hoid_scene.scene_scheduler import SceneRequest
from hoid_scene.tracks.object_track import TrackedObject

CAMERA = CameraModel(640, 480, 525.0, 525.0, 319.5, 239.5)
LOOK_NS = 500_000_000
_FAR_M, _FLOOR_M, _MIN_PX = 5.0, -1.2, 60


class Box(NamedTuple):
    """A box along the axes of the map frame, whose origin is the first camera."""

    class_name: str  # '': furniture that the detector does not know
    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]
    reason: ObjectState = ObjectState.AT_REST
    score: float = 0.9

    @property
    def center_m(self) -> FloatArray:
        """Return the center (3,)."""
        return (np.array(self.low_m) + self.high_m) / 2


class ObjectWorld:
    """A room with boxes, of which an object map gets images, by default two a second."""

    def __init__(self, min_score: float = 0.0, look_ns: int = LOOK_NS) -> None:
        self.map = ObjectMap(CAMERA, min_score)
        self.stamp_ns, self._look_ns = 0, look_ns
        self.color: ByteArray | None = None  # (H, W, 3) of all images; None: there is none
        self.keyframes = keyframes(np.eye(4))

    def look(
        self,
        *boxes: Box,
        T_map_body: FloatArray | None = None,
        T_map_world: FloatArray | None = None,
        tracks: tuple[TrackedObject, ...] = (),
        times: int = 1,
    ) -> tuple[MapObject, ...]:
        """Return the objects of the map after looks at these boxes of the world."""
        T_world_camera = (np.eye(4) if T_map_body is None else T_map_body) @ T_BODY_OPTICAL
        depth_m, seen = rendered(boxes, T_world_camera)
        T_map_camera = T_world_camera if T_map_world is None else T_map_world @ T_world_camera
        for _ in range(times):
            self.stamp_ns += self._look_ns
            request = SceneRequest(self.stamp_ns, T_map_camera, 0, self.keyframes, True, True)
            color = self.color
            image = None if color is None else partial(np.copy, color)
            self.map.update(request, depth_m, seen, tracks, image)
        return self.map.objects()


def keyframes(T_map_keyframe: FloatArray, version: int = 1, uid: int = 0) -> KeyframePoses:
    """Return a snapshot with one keyframe."""
    return KeyframePoses(version, np.array([uid]), np.array([0]), 0, T_map_keyframe[None])


def rendered(
    boxes: tuple[Box, ...], T_map_camera: FloatArray
) -> tuple[Float32Array, list[DynamicObject]]:
    """Return the depth (H, W), and the exact boxes of the visible pixels."""
    v, u = np.mgrid[0 : CAMERA.height_px, 0 : CAMERA.width_px]
    x, y = (u - CAMERA.cx_px) / CAMERA.fx_px, (v - CAMERA.cy_px) / CAMERA.fy_px
    rays = np.stack([x, y, np.ones_like(x)], -1) @ T_map_camera[:3, :3].T
    origin = T_map_camera[:3, 3]
    room = ((-_FAR_M, -_FAR_M, _FLOOR_M), (_FAR_M, _FAR_M, 2.0))
    with np.errstate(divide='ignore'):
        t = ((np.array(room)[:, None, None] - origin) / rays).max(axis=0).min(axis=-1)
        index = np.full(t.shape, -1)
        for i, box in enumerate(boxes):
            low, high = ((np.array(corner) - origin) / rays for corner in box[1:3])
            enter, leave = np.minimum(low, high).max(-1), np.maximum(low, high).min(-1)
            hit = (enter > 0) & (enter < leave) & (enter < t)
            t[hit], index[hit] = enter[hit], i
    detections = []
    for i, box in enumerate(boxes):
        row, col = np.nonzero(index == i)
        if box.class_name and len(row) >= _MIN_PX:
            edges = (
                float(col.min()),
                float(row.min()),
                float(col.max() + 1),
                float(row.max() + 1),
            )
            detections.append(DynamicObject(box.class_name, edges, box.score, -1, box.reason))
    return t.astype(np.float32), detections
