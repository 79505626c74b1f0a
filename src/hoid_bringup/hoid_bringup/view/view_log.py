"""The log file for the Rerun viewer; no other module uses Rerun."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
import rerun as rr
from rerun import blueprint as rrb

from hoid_common import se3
from hoid_common.io import images
from hoid_common.io.files import staged
from hoid_common.values import (
    NS_PER_S,
    ByteArray,
    CameraModel,
    DynamicObject,
    FilterResult,
    Float32Array,
    FloatArray,
    ObjectState,
    RgbdFrame,
    Trajectory,
)
from hoid_filter.drawing import KEPT_BGR, REASON_BGR, REMOVED_BGR, label
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.search.picture_sheet import picture_sheet

MAP = 'map'
POINTS, CLOUD, KEYFRAMES = f'{MAP}/points', f'{MAP}/cloud', f'{MAP}/keyframes'
ESTIMATED_PATH, TRUE_PATH = f'{MAP}/path/estimate', f'{MAP}/path/truth'
OBJECTS, PICTURES = f'{MAP}/objects', 'pictures'
CAMERA = f'{MAP}/camera'
IMAGE, DEPTH = f'{CAMERA}/image', f'{CAMERA}/depth'
BOXES = f'{IMAGE}/boxes'
KEPT, REMOVED = f'{IMAGE}/features/kept', f'{IMAGE}/features/removed'
TIMELINE = 'time'

# The colors of the plots.
_PATH_COLORS = {ESTIMATED_PATH: (255, 196, 61), TRUE_PATH: (150, 156, 168)}
_POINT_COLOR = (120, 200, 255)
_KEYFRAME_COLOR = (90, 130, 220)
_OBJECT_COLOR, _GONE_COLOR = (90, 200, 90), (140, 140, 140)
_FRUSTUM_M = 0.06  # chosen: height of a keyframe's pyramid
_GAP_S = 0.5  # chosen: a longer time without a pose is drawn as a gap
_DEPTH_STRIDE = 2  # chosen: every other row and column, because depth images are most of the file
_JPEG_QUALITY = 85  # chosen


class ViewLog:
    """Context manager that writes a file for the viewer.

    The file appears only when it is complete, and then replaces an existing file.
    """

    def __init__(self, path: Path, *, is_map: bool = False) -> None:
        self._path, self._is_map = path, is_map
        self._staged = staged(path.parent, path)

    def __enter__(self) -> Self:
        unfinished = self._staged.__enter__() / self._path.name
        self._stream = rr.RecordingStream('hoid')
        self._stream.save(unfinished, default_blueprint=_layout(is_map=self._is_map))
        self._stream.log(MAP, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        return self

    def __exit__(self, *error: Any) -> None:
        self._stream.flush()
        self._stream.disconnect()
        self._staged.__exit__(*error)

    def points(self, points_m: Float32Array) -> None:
        """Log the map points (N, 3), in the map frame."""
        self._cloud(POINTS, points_m, _POINT_COLOR, 2.0)

    def cloud(self, points_m: Float32Array, colors_bgr: ByteArray) -> None:
        """Log the dense map: points (N, 3) in the map frame with their colors (N, 3)."""
        self._cloud(CLOUD, points_m, colors_bgr[:, ::-1], 1.5)

    def _cloud(
        self, entity: str, points_m: Float32Array, colors: object, radius_px: float
    ) -> None:
        points = rr.Points3D(points_m, colors=colors, radii=rr.Radius.ui_points(radius_px))
        self._stream.log(entity, points, static=True)

    def path(self, entity: str, trajectory: Trajectory) -> None:
        """Log a trajectory in the map frame as a line, with gaps where 0.5 s have no pose."""
        gaps = np.flatnonzero(np.diff(trajectory.stamps_ns) > _GAP_S * NS_PER_S) + 1
        strips = np.split(trajectory.T_world_camera[:, :3, 3], gaps)
        lines = rr.LineStrips3D(strips, colors=_PATH_COLORS[entity], radii=rr.Radius.ui_points(1))
        self._stream.log(entity, lines, static=True)

    def keyframes(self, T_map_camera: FloatArray, camera: CameraModel | None) -> None:
        """Log a pyramid for each keyframe pose (N, 4, 4); without a camera, of default shape."""
        outline = _frustum_m(camera)
        strips = [se3.transform(T, outline) for T in T_map_camera]
        lines = rr.LineStrips3D(strips, colors=_KEYFRAME_COLOR, radii=rr.Radius.ui_points(0.7))
        self._stream.log(KEYFRAMES, lines, static=True)

    def objects(self, objects: Sequence[MapObject]) -> None:
        """Log the boxes of objects with class and number, and a sheet of their pictures."""
        boxes = rr.Boxes3D(
            centers=[item.center_map_m for item in objects],
            half_sizes=[item.size_m / 2 for item in objects],
            quaternions=[se3.quat_xyzw_from_rotation(o.T_map_object[:3, :3]) for o in objects],
            labels=[f'{item.class_name} {item.object_id}' for item in objects],
            colors=[_OBJECT_COLOR if item.is_present else _GONE_COLOR for item in objects],
        )
        self._stream.log(OBJECTS, boxes, static=True)
        if (sheet := picture_sheet(objects)) is not None:
            jpeg = images.encode_jpeg(sheet, _JPEG_QUALITY)
            picture = rr.EncodedImage(contents=jpeg, media_type='image/jpeg')
            self._stream.log(PICTURES, picture, static=True)

    def camera(self, camera: CameraModel) -> None:
        """Log the camera model of the color images, and that of the depth images, of half size."""
        for entity, stride in ((IMAGE, 1), (DEPTH, _DEPTH_STRIDE)):
            pinhole = rr.Pinhole(
                focal_length=(camera.fx_px / stride, camera.fy_px / stride),
                principal_point=(camera.cx_px / stride, camera.cy_px / stride),
                width=camera.width_px / stride,
                height=camera.height_px / stride,
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=4 * _FRUSTUM_M,
            )
            self._stream.log(entity, pinhole, static=True)

    def frame(
        self, frame: RgbdFrame, result: FilterResult, T_map_camera: FloatArray | None
    ) -> None:
        """Log an image with the results of the filter and, if known, its pose (4, 4)."""
        self._stream.set_time(TIMELINE, timestamp=np.datetime64(frame.stamp_ns, 'ns'))
        self._pose(T_map_camera)
        jpeg = images.encode_jpeg(frame.image_bgr, _JPEG_QUALITY)
        self._stream.log(IMAGE, rr.EncodedImage(contents=jpeg, media_type='image/jpeg'))
        png = _depth_png(frame.depth_m)
        self._stream.log(
            DEPTH, rr.EncodedDepthImage(blob=png, media_type='image/png', meter=images.MM_PER_M)
        )
        self._boxes(result.objects)
        self._features(KEPT, result.features.uv_px, KEPT_BGR[::-1])
        self._features(REMOVED, result.removed_uv_px, REMOVED_BGR[::-1])

    def _pose(self, T_map_camera: FloatArray | None) -> None:
        if T_map_camera is None:
            self._stream.log(CAMERA, rr.Clear(recursive=False))
            return
        pose = rr.Transform3D(translation=T_map_camera[:3, 3], mat3x3=T_map_camera[:3, :3])
        self._stream.log(CAMERA, pose)

    def _boxes(self, objects: tuple[DynamicObject, ...]) -> None:
        boxes = np.array([item.box_xyxy_px for item in objects], np.float32).reshape(-1, 4)
        shown = rr.Boxes2D(
            array=boxes,
            array_format=rr.Box2DFormat.XYXY,
            labels=[_label(item) for item in objects],
            colors=[REASON_BGR[item.state][::-1] for item in objects],
        )
        self._stream.log(BOXES, shown)

    def _features(self, entity: str, uv_px: Float32Array, colors: object) -> None:
        points = rr.Points2D(uv_px, colors=colors, radii=rr.Radius.ui_points(2))
        self._stream.log(entity, points)


def _layout(*, is_map: bool) -> rrb.Blueprint:
    """Return the layout of the window: the map on the left, images or objects on the right."""
    images_seen = rrb.Vertical(
        rrb.Spatial2DView(origin=IMAGE, name='features and verdicts of the filter'),
        rrb.Spatial2DView(origin=DEPTH, name='depth'),
    )
    scene = rrb.Spatial3DView(origin=MAP, name='map')
    of_objects = rrb.Spatial2DView(origin=PICTURES, name='objects')
    views = rrb.Horizontal(scene, of_objects if is_map else images_seen, column_shares=(3, 2))
    return rrb.Blueprint(views, collapse_panels=True)  # open panels would take half of the window


def _frustum_m(camera: CameraModel | None) -> FloatArray:
    """Return a keyframe's pyramid as one polyline (11, 3) in m, in the camera frame."""
    half = np.array([0.6, 0.45])
    if camera is not None:
        half = np.array([camera.width_px / camera.fx_px, camera.height_px / camera.fy_px]) / 2
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
    a, b, c, d = (_FRUSTUM_M * np.append(corner, 1.0) for corner in corners)
    tip = np.zeros(3)
    return np.array([tip, a, b, tip, c, d, tip, b, c, d, a])


def _label(item: DynamicObject) -> str:
    """Return the label of a box; it includes the state unless that is person or at rest."""
    if item.state in (ObjectState.AT_REST, ObjectState.PERSON):
        return label(item)
    return f'{label(item)} {item.state.name.lower()}'


def _depth_png(depth_m: Float32Array) -> bytes:
    """Return a depth image (H, W) in m as 16-bit PNG in mm at half size, limited to 65.535 m."""
    small = depth_m[::_DEPTH_STRIDE, ::_DEPTH_STRIDE] * images.MM_PER_M + 0.5
    small_mm = np.minimum(small, np.iinfo(np.uint16).max).astype(np.uint16)
    _, png = cv2.imencode('.png', small_mm, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return png.tobytes()
