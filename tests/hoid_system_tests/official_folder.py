"""Writes rendered scenes in the layout of TUM RGB-D and of Bonn RGB-D Dynamic."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hoid_bags.tum.cameras import TUM_DEPTH_UNITS_PER_M, camera_from_name
from hoid_common.se3 import quat_xyzw_from_rotation
from hoid_common.values import CameraModel
from hoid_synth.config import FRAME_RATE_HZ, SceneConfig
from hoid_synth.scene import SceneRenderer

_DEPTH_LAG_S = 0.0123  # stamp of a depth image minus that of its color image
_TRUTH_LAG_S = 0.0021  # poses have stamps of their own


def write_official_folder(
    folder: Path, config: SceneConfig, start_s: float, decimals: int, lost: Collection[int] = ()
) -> None:
    """Write a recording with the camera that the folder's name stands for.

    As in the original files, lists begin with comments, color images, depth images and poses have
    different stamps, and there is one depth image more than color images.

    Args:
        folder: The new folder, with an official name.
        config: The scene; its images are 640 x 480.
        start_s: Stamp of the first color image.
        decimals: Number of decimals of image stamps: 6 in TUM RGB-D, 5 in Bonn RGB-D Dynamic.
        lost: Indices of frames without images.
    """
    camera = camera_from_name(folder.name)
    assert camera is not None
    view, renderer = _view_of(camera, config.camera), SceneRenderer(config)
    lists: dict[str, list[str]] = {'rgb': [], 'depth': []}
    for kind in lists:
        (folder / kind).mkdir(parents=True)

    def write(kind: str, stamp_s: float, image: Any) -> None:
        name = f'{kind}/{stamp_s:.{decimals}f}.png'
        assert cv2.imwrite(str(folder / name), image)
        lists[kind].append(f'{stamp_s:.{decimals}f} {name}')

    poses = []
    for i in range(config.frames):
        rendered = renderer.frame(i)
        stamp_s = start_s + i / FRAME_RATE_HZ
        T = rendered.T_world_camera
        numbers = [*T[:3, 3], *quat_xyzw_from_rotation(T[:3, :3])]
        poses.append(f'{stamp_s + _TRUTH_LAG_S:.4f} {" ".join(f"{n:.4f}" for n in numbers)}')
        if i not in lost:
            units = np.round(rendered.frame.depth_m * TUM_DEPTH_UNITS_PER_M).astype(np.uint16)
            write('depth', stamp_s + _DEPTH_LAG_S, view(units, cv2.INTER_NEAREST))
            if i + 1 < config.frames:
                write('rgb', stamp_s, view(rendered.frame.image_bgr, cv2.INTER_LINEAR))
    for name, lines in (*lists.items(), ('groundtruth', poses)):
        head = [f'# {name}', f"# file: '{folder.name}.bag'", '# timestamp filename']
        (folder / f'{name}.txt').write_text('\n'.join([*head, *lines]) + '\n')


def _view_of(camera: CameraModel, rendered: CameraModel) -> Callable[[Any, int], Any]:
    """Return a function that turns a rendered image into that of another camera at its place."""
    v, u = np.indices((camera.height_px, camera.width_px), np.float32)
    K = np.array([[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]])
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    rays = cv2.undistortPoints(pixels, K, np.array(camera.distortion or [0.0] * 4))[:, 0]
    at = rays * [rendered.fx_px, rendered.fy_px] + [rendered.cx_px, rendered.cy_px]
    x, y = at.T.astype(np.float32).reshape(2, camera.height_px, camera.width_px)
    return lambda image, how: cv2.remap(image, x, y, how)
