"""The picture of an object map, and the jitter of its objects."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from hoid_benchmarks.object_picture import draw_objects, object_rows, object_table
from hoid_benchmarks.rooms.room_run import MappedRoom, ObjectHistory
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import CameraModel, FloatArray, ObjectState, RgbdFrame, Trajectory
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.objects.mapped_object import MapObject
from rgbd_slam.mapping.slam_map import SlamStats

CAMERA = CameraModel(320, 240, 250.0, 250.0, 160.0, 120.0)


def mapped(number: int, at_m: FloatArray, state: ObjectState = ObjectState.AT_REST) -> MapObject:
    T = np.eye(4)
    T[:3, 3] = at_m
    return MapObject(number, 'cup', (('cup', 1.0),), state, T, np.full(3, 0.2), 9, 0, 0, 1.0)


CUP = mapped(1, np.array([2.0, 0.0, 0.0]))
GONE = mapped(2, np.array([2.0, 0.8, 0.0]), ObjectState.GONE)


def room() -> MappedRoom:
    cloud = ColoredCloud(np.array([[2.0, 0.5, 0.0]], np.float32), np.zeros((1, 3), np.uint8))
    trajectory = Trajectory(np.array([5]), T_BODY_OPTICAL[None])
    return MappedRoom(cloud, None, {}, (CUP, GONE), {}, trajectory, SlamStats(0, 0))


def test_jitter_is_the_deviation_from_the_median() -> None:
    history: ObjectHistory = {
        k: (mapped(1, np.array([2.0 + x_m, 0.0, 0.0])), GONE)
        for k, x_m in enumerate((0.0, 0.0, 0.0, 0.02))
    }
    (row,) = object_rows([CUP, GONE], history)
    assert row.item is CUP
    assert row.jitter_m == pytest.approx(0.01)
    assert row.late_jitter_m == pytest.approx(0.01)  # 1 cm from the median of the last two
    assert '| 1 | cup | 9 | 0.20 x 0.20 x 0.20 | 1.0 | 1.0 |' in object_table([row])


def test_a_box_is_drawn_where_the_image_shows_it(tmp_path: Path) -> None:
    image = np.full((240, 320, 3), 128, np.uint8)
    frame = RgbdFrame(5, image, np.ones((240, 320), np.float32))
    draw_objects(tmp_path / 'objects.jpg', room(), frame, CAMERA)
    drawn = cv2.imread(str(tmp_path / 'objects.jpg'))
    assert drawn is not None
    left = drawn[:, : drawn.shape[1] // 2].astype(int)  # the plan is farther right
    is_gray = np.ptp(left, axis=2) < 25
    is_image = is_gray & (np.abs(left.mean(axis=2) - 128) < 15)
    rows, columns = np.nonzero(is_image)
    inside = ~is_gray[rows.min() : rows.max(), columns.min() : columns.max()]
    row, column = (np.mean(axis) for axis in np.nonzero(inside))
    # The cup is in front of the camera, in the middle of the image; the other one is gone.
    assert row / len(inside) == pytest.approx(0.5, abs=0.06)
    assert column / inside.shape[1] == pytest.approx(0.5, abs=0.06)
