"""Depth of another camera is brought to the pixels of the color camera; known answers."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import MessageError
from hoid_common.inputs.registration import DepthAligner, Registration
from hoid_common.values import CameraModel, Float32Array, FloatArray

# Cameras of a RealSense D435, and of an Azure Kinect with its lenses.
DEPTH = CameraModel(424, 240, 215.0, 215.0, 211.5, 119.5)
COLOR = CameraModel(640, 480, 610.0, 611.0, 322.0, 238.0)
WIDE_COLOR = replace(COLOR, distortion=(0.1, -0.2, 0.001, -0.001, 0.05))
WIDE_DEPTH = CameraModel(320, 288, 252.0, 252.0, 160.0, 144.0, (0.5, -2.0, 0.0, 0.0, 1.4))
FISHEYE = replace(COLOR, fx_px=560.0, fy_px=560.0, distortion=(-0.02, 0.003), is_fisheye=True)
T_COLOR_DEPTH = se3.from_quat_translation(
    np.array([0.004, -0.006, 0.003, 1.0]), np.array([0.015, -0.001, 0.002])
)
# Planes n . p = d in the color frame: a slanted wall, and a box in front of it.
WALL = np.array([0.2, -0.3, 1.0]), 2.0
BOX_M = (-0.3, -0.2, 0.1, 0.25), 1.0  # left, top, right, bottom, depth


def seen(camera: CameraModel, T_color_camera: FloatArray) -> Float32Array:
    """Return the depth image of wall and box that a camera sees; the box is parallel to color."""
    u, v = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    flat = np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float32)
    x, y = ((camera.undistort_px(flat) - (camera.cx_px, camera.cy_px)).T) / np.array(
        [[camera.fx_px], [camera.fy_px]]
    )
    rays = np.stack([x, y, np.ones_like(x)], axis=1) @ T_color_camera[:3, :3].T
    origin = T_color_camera[:3, 3]
    normal, offset = WALL
    depth = (offset - normal @ origin) / (rays @ normal)
    (left, top, right, bottom), box_m = BOX_M
    at_box = (box_m - origin[2]) / rays[:, 2]
    place = origin + at_box[:, None] * rays
    is_box = (place[:, 0] > left) & (place[:, 0] < right)
    is_box &= (place[:, 1] > top) & (place[:, 1] < bottom)
    found = np.where(is_box & (at_box < depth), at_box, depth)
    return np.asarray(found.reshape(camera.height_px, camera.width_px), np.float32)


@pytest.mark.parametrize(
    ('depth', 'color'),
    [(DEPTH, COLOR), (WIDE_DEPTH, WIDE_COLOR), (DEPTH, WIDE_COLOR), (WIDE_DEPTH, FISHEYE)],
    ids=['pinhole', 'both distorted', 'color distorted', 'fisheye'],
)
def test_registered_depth_is_what_the_color_camera_sees(
    depth: CameraModel, color: CameraModel
) -> None:
    registered_m = Registration(depth, color, T_COLOR_DEPTH)(seen(depth, T_COLOR_DEPTH))
    expected_m = seen(color, np.eye(4))
    # Inside the field of view of the depth camera, and away from the jump at the box.
    h, w = expected_m.shape
    inner = (slice(h // 6, -h // 6), slice(w // 6, -w // 6))
    error_m = np.abs(registered_m - expected_m)[inner]
    has_reading = registered_m[inner] > 0
    assert has_reading.mean() > 0.985
    assert np.median(error_m[has_reading]) < 0.002
    assert (error_m[has_reading] < 0.02).mean() > 0.97


def test_the_registration_of_a_vga_image_is_fast() -> None:
    depth = replace(COLOR, fx_px=380.0, fy_px=380.0)
    mapping, depth_m = Registration(depth, COLOR, T_COLOR_DEPTH), seen(depth, T_COLOR_DEPTH)
    times_s = []
    for _ in range(5):
        start_s = time.process_time()
        mapping(depth_m)
        times_s.append(time.process_time() - start_s)
    assert min(times_s) < 0.02  # measured: 3 ms


def aligner() -> DepthAligner:
    """Return an aligner that knows both cameras and the transform between their frames."""
    made = DepthAligner('register it')
    made.color, made.depth = COLOR, DEPTH
    made.frames.add('color', 'depth', T_COLOR_DEPTH)
    return made


def test_depth_in_another_frame_is_mapped_and_said() -> None:
    made, depth_m = aligner(), seen(DEPTH, T_COLOR_DEPTH)
    expected_m = Registration(DEPTH, COLOR, T_COLOR_DEPTH)(depth_m)
    np.testing.assert_array_equal(made.align(depth_m, '/depth', 'color', (640, 480)), expected_m)
    assert 'depth (frame depth, fx 215.0 px at 424x240) is not registered to color' in made.note
    assert made.doubt == ''


@pytest.mark.parametrize('missing', ['transform', 'depth camera', 'color camera'])
def test_depth_in_another_frame_is_doubted_until_its_geometry_is_known(missing: str) -> None:
    whole, made = aligner(), aligner()
    if missing == 'transform':
        made.frames = DepthAligner('').frames
    elif missing == 'depth camera':
        made.depth = None
    else:
        made.color = None
    same_size_m = np.ones((480, 640), np.float32)
    assert made.align(same_size_m, 'depth', 'color', (640, 480)) is same_size_m
    assert made.doubt == (
        'depth is not registered to color: its frame is depth, that of color color; register it'
    )
    with pytest.raises(MessageError, match='depth is not registered to color'):
        made.align(np.ones((240, 320), np.float32), 'depth', 'color', (640, 480))
    made.frames, made.depth, made.color = whole.frames, whole.depth, whole.color
    made.align(seen(DEPTH, T_COLOR_DEPTH), 'depth', 'color', (640, 480))
    assert made.doubt == ''


def test_registered_depth_is_used_as_it_is() -> None:
    made = DepthAligner('')
    depth_m = np.random.default_rng(0).random((480, 640), np.float32)
    for frames in (('color', 'color'), ('', 'color'), ('depth', ''), ('', '')):
        assert made.align(depth_m, *frames, (640, 480)) is depth_m
        assert made.doubt == made.note == ''
    made.color = made.depth = COLOR
    made.frames.add('color', 'depth', np.eye(4))  # two names of one frame
    assert made.align(depth_m, 'depth', 'color', (640, 480)) is depth_m
    assert made.doubt == made.note == ''


def test_registered_depth_of_a_third_of_the_size_is_repeated() -> None:
    depth_m = np.random.default_rng(0).random((160, 213), np.float32)
    aligned_m = DepthAligner('').align(depth_m, 'color', 'color', (639, 480))
    np.testing.assert_array_equal(aligned_m, np.kron(depth_m, np.ones((3, 3), np.float32)))
    with pytest.raises(MessageError, match='it is 213x160, color 640x480; register it'):
        DepthAligner('register it').align(depth_m, 'color', 'color', (640, 480))


def test_the_intrinsics_of_depth_in_the_same_frame_are_used() -> None:
    made = DepthAligner('')
    made.color, made.depth = COLOR, replace(COLOR, fx_px=590.0, fy_px=591.0)  # 3 % off
    depth_m = seen(made.depth, np.eye(4))
    found_m = made.align(depth_m, 'color', 'color', (640, 480))
    error_m = np.abs(found_m - seen(COLOR, np.eye(4)))[80:-80, 100:-100]
    assert np.median(error_m) < 0.002
    assert (error_m < 0.02).mean() > 0.98
    assert 'is not registered to color' in made.note
