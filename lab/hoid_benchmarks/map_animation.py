"""Images with the filter's decisions beside two growing maps: without and with the filter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np

from hoid_bags.sequence import Sequence
from hoid_benchmarks.captions import BAR_PX, draw_legend, draw_title
from hoid_bringup.run.detection_source import DetectionSource
from hoid_bringup.run.run_config import RunConfig
from hoid_common import se3
from hoid_common.values import (
    BoolArray,
    ByteArray,
    CameraModel,
    Features,
    Float32Array,
    FloatArray,
)
from hoid_filter.drawing import KEPT_BGR, REMOVED_BGR, Bgr, draw_points, draw_result
from hoid_filter.feature_filter import FeatureFilter
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.session import SlamSession

# Chosen: the part of a room that a depth camera sees from its first place.
_AHEAD_M, _BEHIND_M = 3.6, 0.2
_BACKGROUND_BGR: Bgr = (24, 24, 24)
_CAMERA_BGR: Bgr = (255, 255, 255)


class _MapFromAbove:
    """The map of a SLAM session, seen from above: the camera starts at the bottom and looks up.

    It shows the features with depth of all images, at the poses that were estimated for them, and
    the trajectory of the camera.
    """

    def __init__(self, camera: CameraModel, config: RunConfig, title: str) -> None:
        self._session = SlamSession(camera, config.slam, RobotFrames())
        self._title = title
        half = np.zeros((camera.height_px // 2 - BAR_PX, camera.width_px // 2, 3), np.uint8)
        self._points = half + np.array(_BACKGROUND_BGR, np.uint8)
        self._trajectory_m = np.empty((0, 3))

    def add(self, features: Features, is_removed: BoolArray) -> ByteArray:
        """Track an image, and return the map with its features (N,) in their colors."""
        image = self._session.process(features).image
        if image is not None:
            T_map_camera = image.T_map_camera
            self._trajectory_m = np.vstack([self._trajectory_m, T_map_camera[:3, 3]])
            for select, color in ((~is_removed, KEPT_BGR), (is_removed, REMOVED_BGR)):
                points_m = points_camera_m(self._session.camera, features.select(select))
                draw_points(self._points, self._px(se3.transform(T_map_camera, points_m)), color)
        picture = self._points.copy()
        line = np.rint(self._px(self._trajectory_m)).astype(np.int32)
        cv2.polylines(picture, [line], isClosed=False, color=_CAMERA_BGR, thickness=2)
        return draw_title(picture, self._title)

    def _px(self, points_map_m: FloatArray) -> Float32Array:
        """Return pixels (N, 2) of points (N, 3) in a frame with x forward and y left."""
        height, width = self._points.shape[:2]
        px_per_m = height / (_AHEAD_M + _BEHIND_M)
        x = width / 2 - px_per_m * points_map_m[:, 1]
        y = px_per_m * (_AHEAD_M - points_map_m[:, 0])
        return np.column_stack([x, y]).astype(np.float32)


def draw_growing_maps(
    sequence: Sequence, detect: DetectionSource, config: RunConfig
) -> Iterator[ByteArray]:
    """Yield each image with the filter's decisions, beside the maps without and with the filter.

    The map without the filter shows in red what the filter removes: features that are nearer to
    a removed feature than to a kept one.
    """
    camera = sequence.camera
    feature_filter = FeatureFilter(config.filter, camera)
    extractor = FeatureFilter(replace(config.filter, strategy='none'), camera)
    unfiltered_map = _MapFromAbove(camera, config, 'map without filter')
    filtered_map = _MapFromAbove(camera, config, f'map with {config.filter.strategy}')
    for frame in sequence:
        detections = detect(frame)
        result = feature_filter.process(frame, detections, for_picture=True)
        features = extractor.process(frame, detections).features
        is_removed = _distance_px(features.uv_px, result.removed_uv_px) < _distance_px(
            features.uv_px, result.features.uv_px
        )
        none_removed = np.zeros(len(result.features), bool)
        maps = (
            unfiltered_map.add(features, is_removed),
            filtered_map.add(result.features, none_removed),
        )
        image = draw_result(frame.image_bgr, result)
        yield draw_legend(np.hstack([image, np.vstack(maps)]))


def _distance_px(uv_px: Float32Array, others_px: Float32Array) -> Float32Array:
    """Return the distances (N,) of pixels (N, 2) from the nearest of others (M, 2)."""
    gaps = np.linalg.norm(uv_px[:, None] - others_px, axis=2)
    return np.asarray(gaps.min(axis=1, initial=np.inf))


def points_camera_m(camera: CameraModel, features: Features) -> FloatArray:
    """Return the points (N, 3) of the features with depth in the camera frame."""
    seen = features.select(features.depth_m > 0)
    z = seen.depth_m[:, None].astype(np.float64)
    xy = camera.undistort_px(seen.uv_px) - (camera.cx_px, camera.cy_px)
    return np.hstack([xy / (camera.fx_px, camera.fy_px) * z, z])
