"""Measures where detected people and objects are in the map, from the depth inside their boxes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import PERSON, CameraModel, DynamicObject, Float32Array, FloatArray
from hoid_scene.grid.floor import Floor

# None of these numbers was tuned; docs/results/rooms.md has the errors that result from them.
_STRIDE = 4  # step between the pixels used [px]: boxes are many pixels wide
_MIN_RANGE_M, _MAX_RANGE_M = 0.3, 8.0  # chosen: the range of common depth cameras
_MIN_READINGS = 6  # fewer readings do not show where an object is
# A layer is a range of depth as thick as 4 bins. The object is the nearest layer that has at least
# 0.6 times the readings of the layer with most readings: the background behind the object may fill
# more of the box.
_BIN_M, _LAYER_BINS, _NEARER_SHARE = 0.05, 4, 0.6
_CENTRAL_CUT = 0.25  # share of a box cut off on each side, because the border shows the background
_EXTENT_CUT = 0.08  # the same where the size of an object is measured
_EXTENT_PERCENTILES = (4, 96)  # ends of the extent of an object's points, without outliers
# An object is still at its known depth if more than this share of the readings in its box differs
# from the known depth by less than this distance [m].
_KNOWN_SHARE, _KNOWN_M = 0.15, 0.15
# The object's readings are those whose depth differs from the layer's by less than a share of the
# object's width: this share, and the smallest and largest difference [m].
_THICKNESS_SHARE, _THICKNESS_M = 0.6, (0.12, 0.45)
_TORSO_M = 0.45  # a person's readings are within this distance of the nearest layer
_UPPER_SHARE = 0.6  # upper part of a person's box, without the legs, which move back and forth
# Assumed extent along the view of an object whose back is hidden; the width of the object is used
# instead if it is smaller.
_HIDDEN_M = 0.15
_BODY_RADIUS_M = 0.12  # from the surface of the chest to the center of the body
_MIN_DISTANCE_M = 1e-6  # avoids a division by zero


class Sighting(NamedTuple):
    """The measured place and size of one detection in the map frame, whose z axis points up."""

    detection: DynamicObject
    position_map_m: FloatArray  # (3,) center
    size_m: FloatArray  # (3,) extent along the map's axes
    is_at_known_depth: bool  # whether enough of the box is at the depth that its track predicts


@dataclass(frozen=True, eq=False)
class DepthImage:
    """Every fourth pixel of a depth image, with its pose."""

    camera: CameraModel
    depth_m: Float32Array  # (h, w); 0: no reading
    T_map_camera: FloatArray  # (4, 4)

    @staticmethod
    def of(camera: CameraModel, depth_m: Float32Array, T_map_camera: FloatArray) -> DepthImage:
        """Return every fourth pixel of a full depth image (H, W) with its pose T_map_camera."""
        return DepthImage(camera, depth_m[::_STRIDE, ::_STRIDE], T_map_camera)

    def depth_of_m(self, position_map_m: FloatArray) -> float:
        """Return the depth [m], in this image's camera frame, of a point (3,) of the map frame."""
        return float(self._in_camera(position_map_m)[2])

    def pixel_of(self, position_map_m: FloatArray) -> FloatArray | None:
        """Return the pixel (2,) u, v of the full image for a point (3,) of the map frame.

        The pixel may lie outside the image. None is returned if the point is less than 0.3 m in
        front of the camera, or behind it.
        """
        point = self._in_camera(position_map_m)
        return self.camera.project_px(point[None])[0] if point[2] > _MIN_RANGE_M else None

    def has_in_view(self, position_map_m: FloatArray) -> bool:
        """Return whether a point (3,) of the map frame projects into the image."""
        uv = self.pixel_of(position_map_m)
        size_px = (self.camera.width_px, self.camera.height_px)
        return uv is not None and bool((uv >= 0).all() and (uv < size_px).all())

    def sees_through(self, position_map_m: FloatArray, margin_m: float) -> bool | None:
        """Return whether the surface measured in the direction of a point is behind the point.

        None is returned if this is unknown: there are too few readings, the point is nearer than
        0.3 m, farther than 4 m or out of view, or something occludes it.
        """
        point = self._in_camera(position_map_m)
        if not _MIN_RANGE_M < point[2] < _MAX_RANGE_M / 2:  # beyond, depth is too noisy
            return None
        col, row = np.rint(self.camera.project_px(point[None])[0] / _STRIDE).astype(int)
        height, width = self.depth_m.shape
        if not (2 <= col < width - 2 and 2 <= row < height - 2):
            return None
        window = self.depth_m[row - 1 : row + 2, col - 1 : col + 2]
        read = window[window > 0]
        if len(read) < _MIN_READINGS or read.min() < point[2] - margin_m:
            return None  # too few readings, or something occludes the point
        return bool(np.median(read) > point[2] + margin_m)

    def _in_camera(self, position_map_m: FloatArray) -> FloatArray:
        return np.asarray(se3.transform(se3.inverse(self.T_map_camera), position_map_m[None])[0])

    def readings(
        self, box_xyxy_px: tuple[float, ...], cut: float
    ) -> tuple[Float32Array, Float32Array]:
        """Return depths (M,) [m] and pixels (M, 2) u, v in a box, cut by a ratio on each side."""
        x1, y1, x2, y2 = box_xyxy_px
        dx, dy = cut * (x2 - x1), cut * (y2 - y1)
        left, right = max(0, int((x1 + dx) / _STRIDE)), int(np.ceil((x2 - dx) / _STRIDE))
        top, bottom = max(0, int((y1 + dy) / _STRIDE)), int(np.ceil((y2 - dy) / _STRIDE))
        part = self.depth_m[top:bottom, left:right]
        row, col = np.nonzero((part > 0) & (part < _MAX_RANGE_M))
        uv = np.stack([col + left, row + top], axis=1).astype(np.float32) * _STRIDE
        return part[row, col], np.asarray(uv, np.float32)

    def points_map_m(self, uv_px: Float32Array, depth_m: Float32Array) -> FloatArray:
        """Return the points (M, 3) in the map frame of raw pixels (M, 2) with depth (M,)."""
        rays = self.camera.undistort_px(uv_px).astype(np.float64)
        x = (rays[:, 0] - self.camera.cx_px) / self.camera.fx_px * depth_m
        y = (rays[:, 1] - self.camera.cy_px) / self.camera.fy_px * depth_m
        return se3.transform(self.T_map_camera, np.stack([x, y, depth_m], axis=1))


def measure(
    detection: DynamicObject,
    image: DepthImage,
    known_map_m: FloatArray | None,
    floor: Floor | None,
) -> Sighting | None:
    """Return the place and size of a detected person or object, or None without enough depth.

    Args:
        known_map_m: (3,) position that the object's track predicts in the map frame; None if it
            has no track. If enough of the box is at this depth, the object is measured there. If
            not, or without a track, it is measured at the nearest layer of depth.
    """
    depth, _ = image.readings(detection.box_xyxy_px, _CENTRAL_CUT)
    if len(depth) < _MIN_READINGS:
        depth, _ = image.readings(detection.box_xyxy_px, 0.0)
    if len(depth) < _MIN_READINGS:
        return None
    is_person = detection.class_name == PERSON
    known_m = np.nan if known_map_m is None else image.depth_of_m(known_map_m)
    near = np.abs(depth - known_m) < (_TORSO_M if is_person else _KNOWN_M)
    is_at_known_depth = bool(near.mean() > _KNOWN_SHARE)
    layer_m = float(np.median(depth[near])) if is_at_known_depth else _nearest_layer(depth)
    if is_person:
        return _measure_person(detection, image, layer_m, floor, is_at_known_depth)
    return _measure_object(detection, image, layer_m, is_at_known_depth)


def _nearest_layer(depth: Float32Array) -> float:
    """Return the median depth [m] of the nearest layer that is filled well (`_NEARER_SHARE`)."""
    bins = (depth / _BIN_M).astype(np.int64)
    count = np.bincount(bins, minlength=_LAYER_BINS)
    layers = np.convolve(count, np.ones(_LAYER_BINS))[_LAYER_BINS - 1 :]
    first = int(np.argmax(layers >= _NEARER_SHARE * layers.max()))
    first += int(np.argmax(layers[first : first + _LAYER_BINS]))
    inside = (bins >= first) & (bins < first + _LAYER_BINS)
    return float(np.median(depth[inside]))


def _measure_person(
    detection: DynamicObject,
    image: DepthImage,
    layer_m: float,
    floor: Floor | None,
    is_at_known_depth: bool,
) -> Sighting | None:
    """Return the center and size of a person; None if there are too few depth readings.

    The person reaches from the top of the box down to the floor, or to the bottom of the box if
    the floor is unknown.
    """
    x1, y1, x2, y2 = detection.box_xyxy_px
    depth, uv = image.readings(detection.box_xyxy_px, 0.0)
    body = np.abs(depth - layer_m) < _TORSO_M
    if np.count_nonzero(body) < _MIN_READINGS:
        return None
    upper = uv[:, 1] < y1 + _UPPER_SHARE * (y2 - y1)
    if np.count_nonzero(body & upper) >= _MIN_READINGS:
        body &= upper
    points = image.points_map_m(uv[body], depth[body])
    middle = np.median(points, axis=0)
    away = middle[:2] - image.T_map_camera[:2, 3]
    middle[:2] += _BODY_RADIUS_M * away / max(float(np.linalg.norm(away)), _MIN_DISTANCE_M)
    ends = np.array([[(x1 + x2) / 2, y1], [(x1 + x2) / 2, y2]], np.float32)
    high, low = image.points_map_m(ends, np.full(2, layer_m, np.float32))[:, 2]
    if floor is not None:
        low = min(high, floor.height_m(*middle[:2].tolist()))
    middle[2] = (high + low) / 2
    width = (x2 - x1) / image.camera.fx_px * layer_m
    size_m = np.array([width, width, high - low])
    return Sighting(detection, middle, size_m, is_at_known_depth)


def _measure_object(
    detection: DynamicObject,
    image: DepthImage,
    layer_m: float,
    is_at_known_depth: bool,
) -> Sighting | None:
    """Return the center and size of an object at the depth `layer_m` in the camera frame.

    The center is that of the whole object: its hidden back is estimated from its width. The size
    is that of the visible part. None is returned if there are too few depth readings.
    """
    x1, _, x2, _ = detection.box_xyxy_px
    width_m = (x2 - x1) / image.camera.fx_px * layer_m
    thickness_m = float(np.clip(_THICKNESS_SHARE * width_m, *_THICKNESS_M))
    for cut in (_EXTENT_CUT, 0.0):  # some objects have readings only at their border
        depth, uv = image.readings(detection.box_xyxy_px, cut)
        part = np.abs(depth - layer_m) < thickness_m
        if np.count_nonzero(part) >= _MIN_READINGS:
            break
    else:
        return None
    points = image.points_map_m(uv[part], depth[part])
    low, high = np.percentile(points, _EXTENT_PERCENTILES, axis=0)
    near_m, far_m = np.percentile(depth[part], _EXTENT_PERCENTILES)
    hidden_m = max(0.0, min(width_m, _HIDDEN_M) - (far_m - near_m))
    middle = (low + high) / 2 + image.T_map_camera[:3, 2] * hidden_m / 2
    size_m = (high - low) / (1 - 2 * cut)
    return Sighting(detection, middle, size_m, is_at_known_depth)
