"""A screen with a moving picture that stands in a recorded room."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from hoid_common import se3
from hoid_common.values import S_PER_NS, CameraModel, FloatArray, RgbdFrame, Trajectory

_AHEAD_M = 0.8  # from the first camera pose, in the middle of its image, which it faces
_HEIGHT_PER_WIDTH = 9 / 16
_SPEED_MPS = 0.1  # of the picture, across the screen
_PX_PER_M = 800  # of the picture
_TILE_PX = 24  # random tiles, whose borders have corners at all octaves
_SEED = 3


class MovingPicture:
    """Paints the screen into the images of a recording, by their ground-truth poses.

    The depth images contain the screen as a plane at rest. What is nearer hides it.

    Args:
        camera: The camera.
        truth: Ground-truth poses of the camera.
        width_m: Width of the screen.
    """

    def __init__(self, camera: CameraModel, truth: Trajectory, width_m: float) -> None:
        self._camera, self._truth = camera, truth
        self._size_m = np.array([width_m, _HEIGHT_PER_WIDTH * width_m])
        T_camera_screen = np.eye(4)
        T_camera_screen[2, 3] = _AHEAD_M
        self._T_world_screen = truth.T_world_camera[0] @ T_camera_screen
        rows, columns = np.ceil(_PX_PER_M * self._size_m[::-1] / _TILE_PX).astype(int)
        tiles = np.random.default_rng(_SEED).integers(0, 256, (rows, columns, 3))
        tile = np.ones((_TILE_PX, _TILE_PX, 1))
        self._picture = cv2.GaussianBlur(np.kron(tiles, tile).astype(np.uint8), (0, 0), 1.0)
        v, u = np.mgrid[: camera.height_px, : camera.width_px]
        pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float32)
        ideal = camera.undistort_px(pixels).reshape(*u.shape, 2)
        center_px, focal_px = (camera.cx_px, camera.cy_px), (camera.fx_px, camera.fy_px)
        self._rays = np.concatenate(
            [(ideal - center_px) / focal_px, np.ones((*u.shape, 1))], axis=2
        )  # (H, W, 3) with z = 1

    def painted(self, frame: RgbdFrame) -> RgbdFrame:
        """Return the frame with the screen in it, where the screen is in view."""
        T_screen_camera = se3.inverse(self._T_world_screen) @ self._pose_at(frame.stamp_ns)
        direction, start_m = self._rays @ T_screen_camera[:3, :3].T, T_screen_camera[:3, 3]
        with np.errstate(divide='ignore', invalid='ignore'):
            depth_m = -start_m[2] / direction[..., 2]  # along the optical axis, as z = 1
            at_m = start_m[:2] + depth_m[..., None] * direction[..., :2]
        inside = (np.abs(at_m) < self._size_m / 2).all(axis=2) & (depth_m > 0)
        is_seen = inside & ((frame.depth_m == 0) | (depth_m < frame.depth_m))
        moved_m = _SPEED_MPS * (frame.stamp_ns - self._truth.stamps_ns[0]) * S_PER_NS
        place_px = (_PX_PER_M * (at_m + self._size_m / 2 + [moved_m, 0.0])).astype(np.float32)
        shown = cv2.remap(
            self._picture,
            np.where(inside, place_px[..., 0] % self._picture.shape[1], 0.0),
            np.where(inside, place_px[..., 1], 0.0).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_WRAP,
        )
        return replace(
            frame,
            image_bgr=np.where(is_seen[..., None], shown, frame.image_bgr),
            depth_m=np.where(is_seen, depth_m, frame.depth_m).astype(np.float32),
        )

    def _pose_at(self, stamp_ns: int) -> FloatArray:
        nearest = np.argmin(np.abs(self._truth.stamps_ns - stamp_ns))
        pose: FloatArray = self._truth.T_world_camera[nearest]
        return pose
