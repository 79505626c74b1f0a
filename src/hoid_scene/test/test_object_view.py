"""The depth of dark screens, compared with rendered planes."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common.values import CameraModel, DynamicObject, Float32Array, FloatArray, ObjectState
from hoid_scene.objects.evidence import Views
from hoid_scene.objects.object_view import ObjectCamera

CAMERA = CameraModel(640, 480, 525.0, 525.0, 319.5, 239.5)
BOX = (200.0, 120.0, 360.0, 240.0)
SCREEN = DynamicObject('tv', BOX, 0.9, -1, ObjectState.AT_REST)
WALL_M, FRAME_PX = 4.5, 3


def plane_m(slope: float) -> Float32Array:
    """Return the depth (H, W) of a plane 3 m ahead: z = 3 + slope * x."""
    x = (np.arange(CAMERA.width_px) - CAMERA.cx_px) / CAMERA.fx_px
    depth_m = 3.0 / (1 - slope * x)
    return np.tile(depth_m.astype(np.float32), (CAMERA.height_px, 1))


def screen_m(slope: float) -> Float32Array:
    """Return a depth image (H, W) of a frame without readings inside, before a wall."""
    left, top, right, bottom = (int(n) for n in BOX)
    depth_m = np.full((CAMERA.height_px, CAMERA.width_px), WALL_M, np.float32)
    depth_m[top:bottom, left:right] = plane_m(slope)[top:bottom, left:right]
    f = FRAME_PX
    depth_m[top + f : bottom - f, left + f : right - f] = 0
    return depth_m


@pytest.mark.parametrize('slope', [0.0, 0.2])
def test_a_screen_has_the_depth_of_its_frame(slope: float) -> None:
    depth_m = screen_m(slope)
    view = ObjectCamera(CAMERA).view(depth_m, np.eye(4))
    view.fill_screens(depth_m, [SCREEN])
    inside = slice(136 // 4, 224 // 4), slice(216 // 4, 344 // 4)
    assert view.depth_m[inside] == pytest.approx(plane_m(slope)[::4, ::4][inside], abs=0.01)
    points_m = view.points_map_m.reshape(*view.shape, 3)[inside]
    assert points_m[..., 2] == pytest.approx(view.depth_m[inside])
    outside = view.depth_m[:28]
    assert outside == pytest.approx(WALL_M)


def test_a_box_with_few_holes_stays_as_it_is() -> None:
    depth_m = plane_m(0.0)
    depth_m[150:200, 230:280] = 0
    view = ObjectCamera(CAMERA).view(depth_m, np.eye(4))
    before = view.depth_m.copy()
    view.fill_screens(depth_m, [SCREEN])
    assert np.array_equal(view.depth_m, before)


def direction(angle_deg: float) -> FloatArray:
    return np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg)), 0.0])


def test_repeated_detections_from_one_direction_count_less_and_less() -> None:
    views = Views()
    weights = [views.add(direction(angle)) for angle in (0, 4, -4, 2, 0, 3, 0, 0, 0, 0)]
    assert weights[:5] == [1.0, 1.0, 1.0, 0.5, 0.25]
    assert sum(weights) < 4.0


def test_detections_from_other_directions_count_fully() -> None:
    views = Views()
    weights = [views.add(direction(angle)) for angle in range(0, 360, 12)]
    assert weights == [1.0] * 30
    assert [views.add(direction(120)) for _ in range(3)] == [1.0, 1.0, 0.5]
