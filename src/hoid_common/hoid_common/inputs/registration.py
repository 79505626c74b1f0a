"""Registration of depth images to the color camera, by one rule for live images and recordings."""

from __future__ import annotations

import cv2
import numpy as np

from hoid_common.errors import MessageError
from hoid_common.poses.frames import StaticFrames
from hoid_common.values import CameraModel, Float32Array, FloatArray
from hoid_native import Pinhole, register_depth

_NOT_REGISTERED = 'depth is not registered to color: {}; {}'
_NO_READING = cv2.BORDER_CONSTANT  # 0 outside the image
# Chosen: a color pixel gets no depth if its undistorted position is outside the image by more than
# this ratio of the image size: it is too close to the edge of a wide lens.
_MARGIN = 0.5
# Chosen: two cameras count as one if focal lengths and centers differ by less than this ratio of
# the image width, and positions and orientations by less than this distance and angle. Depth noise
# is larger.
_SAME_SHARE, _SAME_M, _SAME_RAD = 0.005, 0.001, 0.002


class Registration:
    """Maps depth images to the pixels of a color camera, by both cameras and T_color_depth."""

    def __init__(self, depth: CameraModel, color: CameraModel, T_color_depth: FloatArray) -> None:
        self._size_px = depth.size_px
        rays = _rays(depth) @ T_color_depth[:3, :3].T
        self._rays = rays.astype(np.float32).reshape(depth.height_px, depth.width_px, 3)
        self._t_m = T_color_depth[:3, 3].astype(np.float32)
        focal = color.fx_px / depth.fx_px, color.fy_px / depth.fy_px
        self._side_px = np.array(focal, np.float32)
        # The kernel registers to a camera without lens distortion. Each color pixel then gets the
        # depth at its undistorted position in that result.
        self._places: tuple[Float32Array, Float32Array] | None = None
        low, size = np.zeros(2, int), np.array(color.size_px)
        if any(color.distortion):
            places = _undistorted_places(color)
            first, last = places.min(axis=(0, 1)), places.max(axis=(0, 1))
            low = np.maximum(np.floor(first), -_MARGIN * size).astype(int)
            size = np.minimum(np.ceil(last) + 1, (1 + _MARGIN) * size).astype(int) - low
            u, v = (places - low.astype(np.float32)).transpose(2, 0, 1)
            self._places = np.ascontiguousarray(u), np.ascontiguousarray(v)
        self._target_size_px = int(size[0]), int(size[1])
        self._target = Pinhole(
            color.fx_px, color.fy_px, color.cx_px - float(low[0]), color.cy_px - float(low[1])
        )

    def __call__(self, depth_m: Float32Array) -> Float32Array:
        """Return the depth (H, W) in m at the color pixels of depth (h, w); 0 = no measurement.

        MessageError if the depth image has another size than its camera.
        """
        if depth_m.shape[::-1] != self._size_px:
            raise MessageError(
                f'depth image is {depth_m.shape[1]}x{depth_m.shape[0]}, its camera_info is of '
                f'{self._size_px[0]}x{self._size_px[1]} px'
            )
        seen_m = register_depth(
            depth_m, self._rays, self._t_m, self._side_px, self._target, self._target_size_px
        )
        if self._places is None:
            return seen_m
        found = cv2.remap(seen_m, *self._places, cv2.INTER_NEAREST, borderMode=_NO_READING)
        return np.asarray(found, np.float32)


class DepthAligner:
    """Returns depth images at the pixels of color images, registered by the driver or not.

    Depth with the frame of color, or with an empty frame, counts as registered; each of its pixels
    is repeated if color is a whole number of times larger. Depth with another frame is mapped by
    `Registration` once its camera and the transform are known; until then it counts as registered,
    and `doubt` says so. Errors end with the `remedy`.
    """

    def __init__(self, remedy: str) -> None:
        self._remedy = remedy
        self.frames = StaticFrames()
        self.color: CameraModel | None = None
        self.depth: CameraModel | None = None  # from the camera_info beside the depth images
        self.doubt = ''  # one line if depth may not be registered, else ''
        # One line about how depth is changed to match color; '' = it is used as it is.
        self.note = ''
        self._known: tuple[object, ...] = ()
        self._registration: Registration | None = None

    def align(
        self, depth_m: Float32Array, depth_frame: str, color_frame: str, size_px: tuple[int, int]
    ) -> Float32Array:
        """Return the depth (H, W) in m at the color pixels of depth (h, w); 0 = no measurement.

        An empty frame name means "unknown". MessageError if unregistered depth has another size.
        """
        own_size_px = depth_m.shape[1], depth_m.shape[0]
        self._update((depth_frame.lstrip('/'), color_frame.lstrip('/')), own_size_px, size_px)
        if self._registration is not None:
            return self._registration(depth_m)
        check_multiple(own_size_px, size_px, self._remedy)
        if own_size_px == size_px:
            return depth_m
        if self.doubt:
            raise MessageError(self.doubt)
        repeated = cv2.resize(depth_m, size_px, interpolation=cv2.INTER_NEAREST)
        return np.asarray(repeated, np.float32)

    def _update(
        self, frames: tuple[str, str], depth_px: tuple[int, int], color_px: tuple[int, int]
    ) -> None:
        depth_frame, color_frame = frames
        T_color_depth = self.frames.find(color_frame, depth_frame) if all(frames) else None
        color = self.color if self.color is not None and self.color.size_px == color_px else None
        depth = self.depth.scaled_to(depth_px) if self.depth is not None else None
        place = None if T_color_depth is None else T_color_depth.tobytes()
        known = frames, depth_px, color_px, color, depth, place
        if known == self._known:
            return
        self._known, self._registration, self.doubt, self.note = known, None, '', ''
        if color is not None and depth is not None and T_color_depth is not None:
            if not _is_same(color, depth, T_color_depth):
                self._registration = Registration(depth, color, T_color_depth)
                self.note = _note(frames, depth, color)
        elif all(frames) and depth_frame != color_frame:
            reason = f'its frame is {depth_frame}, that of color {color_frame}'
            self.doubt = _NOT_REGISTERED.format(reason, self._remedy)


def _note(frames: tuple[str, str], depth: CameraModel, color: CameraModel) -> str:
    texts = [
        f'(frame {frame}, fx {camera.fx_px:.1f} px at {camera.width_px}x{camera.height_px})'
        for frame, camera in zip(frames, (depth, color), strict=True)
    ]
    return f'depth {texts[0]} is not registered to color {texts[1]}: it is mapped there'


def check_multiple(size_px: tuple[int, int], color_px: tuple[int, int], remedy: str) -> None:
    """Raise MessageError unless color (width, height) is a whole multiple of depth `size_px`."""
    factor = color_px[0] // size_px[0]
    if color_px != (size_px[0] * factor, size_px[1] * factor):
        sizes = f'it is {size_px[0]}x{size_px[1]}, color {color_px[0]}x{color_px[1]}'
        raise MessageError(_NOT_REGISTERED.format(sizes, remedy))


def _rays(camera: CameraModel) -> FloatArray:
    """Return the undistorted rays (H * W, 3) of all pixels in the optical frame, with z = 1."""
    u, v = _undistorted_places(camera).reshape(-1, 2).astype(np.float64).T
    x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    return np.stack([x, y, np.ones_like(x)], axis=1)


def _undistorted_places(camera: CameraModel) -> Float32Array:
    """Return the undistorted position (H, W, 2) of each pixel of the raw image, in pixels."""
    u, v = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float32)
    return camera.undistort_px(pixels).reshape(camera.height_px, camera.width_px, 2)


def _is_same(color: CameraModel, depth: CameraModel, T_color_depth: FloatArray) -> bool:
    """Return whether depth needs no registration: the two cameras differ in image size only.

    Lens distortion is not compared: drivers that register depth to raw color publish it with or
    without.
    """
    scaled = depth.scaled_to(color.size_px)
    if scaled is None:
        return False
    off_px = np.abs(scaled.matrix - color.matrix).max()
    angle_rad = np.linalg.norm(cv2.Rodrigues(T_color_depth[:3, :3])[0])
    distance_m = np.linalg.norm(T_color_depth[:3, 3])
    return bool(
        off_px < _SAME_SHARE * color.width_px and distance_m < _SAME_M and angle_rad < _SAME_RAD
    )
