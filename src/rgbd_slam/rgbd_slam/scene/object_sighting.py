"""Where detected people and objects are in the map, measured on the depth image in their boxes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import PERSON, CameraModel, DynamicObject, Float32Array, FloatArray
from rgbd_slam.scene.floor import Floor

_STRIDE = 4  # of the depth image: boxes are large
_MIN_RANGE_M, _MAX_RANGE_M = 0.3, 8.0
_BIN_M = 0.05
_LAYER_BINS = 4
_NEARER_SHARE = 0.6  # of the fullest layer: a nearer one that full is the object
_CENTRAL = 0.25  # share of a box cut off on every side, where the background shows
_MIN_PIXELS = 6
_CORNERS = 0.08  # the same, for an object's extent
_KNOWN_M = 0.15
_KNOWN_SHARE = 0.15  # of a box at the depth where its object is known to be: it is there
_THICKNESS_M = (0.12, 0.45)  # of the layer that an object takes, by its width
_TORSO_M = 0.45
_HIDDEN_M = 0.15  # an object seen from one side only is taken to be this deep, or as it is wide
_BODY_RADIUS_M = 0.12  # from the chest's surface to the middle of the body


class Sighting(NamedTuple):
    """One detected person or object in the map frame (z up)."""

    seen: DynamicObject
    position_map_m: FloatArray  # (3,), centre
    size_m: FloatArray  # (3,), extent along the map's axes
    is_known: bool  # enough of the box is at the depth where it was thought to be


@dataclass(frozen=True, eq=False)
class DepthScene:
    """One depth image, every fourth pixel, and where it was taken."""

    camera: CameraModel
    depth_m: Float32Array  # (h, w); 0 = no reading
    T_map_camera: FloatArray  # (4, 4)

    @staticmethod
    def of(camera: CameraModel, depth_m: Float32Array, T_map_camera: FloatArray) -> DepthScene:
        """Take a full depth image (H, W)."""
        return DepthScene(camera, depth_m[::_STRIDE, ::_STRIDE], T_map_camera)

    def depth_of_m(self, position_map_m: FloatArray) -> float:
        """Return the depth at which this image should see a place."""
        return float(self._in_camera(position_map_m)[2])

    def pixel_of(self, position_map_m: FloatArray) -> FloatArray | None:
        """Return the pixel (2,) of a place, or None when it is behind the camera."""
        point = self._in_camera(position_map_m)
        return self.camera.project_px(point[None])[0] if point[2] > _MIN_RANGE_M else None

    def has_in_view(self, position_map_m: FloatArray) -> bool:
        """Return whether a place lies within the image, seen or hidden."""
        uv = self.pixel_of(position_map_m)
        size_px = (self.camera.width_px, self.camera.height_px)
        return uv is not None and bool((uv >= 0).all() and (uv < size_px).all())

    def sees_through(self, position_map_m: FloatArray, margin_m: float) -> bool | None:
        """Return whether the image looks through a place; None when it cannot tell."""
        point = self._in_camera(position_map_m)
        if not _MIN_RANGE_M < point[2] < _MAX_RANGE_M / 2:
            return None
        col, row = np.rint(self.camera.project_px(point[None])[0] / _STRIDE).astype(int)
        height, width = self.depth_m.shape
        if not (2 <= col < width - 2 and 2 <= row < height - 2):
            return None
        window = self.depth_m[row - 1 : row + 2, col - 1 : col + 2]
        read = window[window > 0]
        if len(read) < _MIN_PIXELS or read.min() < point[2] - margin_m:
            return None  # no readings, or something before it
        return bool(np.median(read) > point[2] + margin_m)

    def _in_camera(self, position_map_m: FloatArray) -> FloatArray:
        return np.asarray(se3.transform(se3.inverse(self.T_map_camera), position_map_m[None])[0])

    def readings(
        self, box_xyxy_px: tuple[float, ...], cut: float
    ) -> tuple[Float32Array, Float32Array]:
        """Return depths (M,) and pixels (M, 2) of the readings in a box, cut on every side."""
        x1, y1, x2, y2 = box_xyxy_px
        dx, dy = cut * (x2 - x1), cut * (y2 - y1)
        left, right = max(0, int((x1 + dx) / _STRIDE)), int(np.ceil((x2 - dx) / _STRIDE))
        top, bottom = max(0, int((y1 + dy) / _STRIDE)), int(np.ceil((y2 - dy) / _STRIDE))
        part = self.depth_m[top:bottom, left:right]
        row, col = np.nonzero((part > 0) & (part < _MAX_RANGE_M))
        uv = np.stack([col + left, row + top], axis=1).astype(np.float32) * _STRIDE
        return part[row, col], np.asarray(uv, np.float32)

    def points_map_m(self, uv_px: Float32Array, depth_m: Float32Array) -> FloatArray:
        """Return (M, 3) points."""
        rays = self.camera.undistort_px(uv_px).astype(np.float64)
        x = (rays[:, 0] - self.camera.cx_px) / self.camera.fx_px * depth_m
        y = (rays[:, 1] - self.camera.cy_px) / self.camera.fy_px * depth_m
        return se3.transform(self.T_map_camera, np.stack([x, y, depth_m], axis=1))


def sight(
    seen: DynamicObject, scene: DepthScene, known_map_m: FloatArray | None, floor: Floor | None
) -> Sighting | None:
    """Measure a detected person or object; None when the depth image does not show it.

    Args:
        known_map_m: (3,) where it is thought to be; believed when enough of the box agrees.
        floor: When known, people stand on it.
    """
    depth, _ = scene.readings(seen.box_xyxy_px, _CENTRAL)
    if len(depth) < _MIN_PIXELS:
        depth, _ = scene.readings(seen.box_xyxy_px, 0.0)
    if len(depth) < _MIN_PIXELS:
        return None
    is_person = seen.class_name == PERSON
    known_m = np.nan if known_map_m is None else scene.depth_of_m(known_map_m)
    near = np.abs(depth - known_m) < (_TORSO_M if is_person else _KNOWN_M)
    is_known = bool(near.mean() > _KNOWN_SHARE)
    layer_m = float(np.median(depth[near])) if is_known else _nearest_layer(depth)
    if is_person:
        return _sight_person(seen, scene, layer_m, floor, is_known)
    return _sight_object(seen, scene, layer_m, is_known)


def _nearest_layer(depth: Float32Array) -> float:
    """Return the depth (m) of the nearest layer of readings (M,) that is about the fullest."""
    count = np.bincount((depth / _BIN_M).astype(np.int64), minlength=_LAYER_BINS)
    layers = np.convolve(count, np.ones(_LAYER_BINS))[_LAYER_BINS - 1 :]
    first = int(np.argmax(layers >= _NEARER_SHARE * layers.max()))
    first += int(np.argmax(layers[first : first + _LAYER_BINS]))
    inside = (depth >= first * _BIN_M) & (depth < (first + _LAYER_BINS) * _BIN_M)
    return float(np.median(depth[inside]))


def _sight_person(
    seen: DynamicObject,
    scene: DepthScene,
    layer_m: float,
    floor: Floor | None,
    is_known: bool,
) -> Sighting | None:
    x1, y1, x2, y2 = seen.box_xyxy_px
    depth, uv = scene.readings(seen.box_xyxy_px, 0.0)
    body = np.abs(depth - layer_m) < _TORSO_M
    if np.count_nonzero(body) < _MIN_PIXELS:
        return None
    upper = uv[:, 1] < y1 + 0.6 * (y2 - y1)
    if np.count_nonzero(body & upper) >= _MIN_PIXELS:
        body &= upper
    points = scene.points_map_m(uv[body], depth[body])
    middle = np.median(points, axis=0)
    away = middle[:2] - scene.T_map_camera[:2, 3]
    middle[:2] += _BODY_RADIUS_M * away / max(float(np.linalg.norm(away)), 1e-6)
    ends = np.array([[(x1 + x2) / 2, y1], [(x1 + x2) / 2, y2]], np.float32)
    high, low = scene.points_map_m(ends, np.full(2, layer_m, np.float32))[:, 2]
    if floor is not None:
        low = min(high, floor.height_m(*middle[:2].tolist()))
    middle[2] = (high + low) / 2
    width = (x2 - x1) / scene.camera.fx_px * layer_m
    return Sighting(seen, middle, np.array([width, width, high - low]), is_known)


def _sight_object(
    seen: DynamicObject, scene: DepthScene, layer_m: float, is_known: bool
) -> Sighting | None:
    x1, _, x2, _ = seen.box_xyxy_px
    width_m = (x2 - x1) / scene.camera.fx_px * layer_m
    thickness_m = float(np.clip(0.6 * width_m, *_THICKNESS_M))
    for cut in (_CORNERS, 0.0):  # what has readings on its border only is seen there
        depth, uv = scene.readings(seen.box_xyxy_px, cut)
        part = np.abs(depth - layer_m) < thickness_m
        if np.count_nonzero(part) >= _MIN_PIXELS:
            break
    else:
        return None
    points = scene.points_map_m(uv[part], depth[part])
    low, high = np.percentile(points, (4, 96), axis=0)
    near_m, far_m = np.percentile(depth[part], (4, 96))
    hidden_m = max(0.0, min(width_m, _HIDDEN_M) - (far_m - near_m))
    middle = (low + high) / 2 + scene.T_map_camera[:3, 2] * hidden_m / 2
    return Sighting(seen, middle, (high - low) / (1 - 2 * _CORNERS), is_known)
