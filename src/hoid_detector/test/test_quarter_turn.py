"""A camera that is mounted turned sees the same people in the same places."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from hoid_detector.config import DetectorConfig
from hoid_detector.onnx_detector import OnnxDetector
from hoid_detector.quarter_turn import (
    boxes_before_turn,
    mounted_roll_deg,
    nearest_quarter,
    turned,
)

SHARED = Path(__file__).resolve().parents[3].parent / 'shared'
MODEL = SHARED / 'models' / 'yolov8n_int8.onnx'


@pytest.mark.parametrize(
    ('roll_deg', 'quarters'), [(0, 0), (44, 0), (46, 1), (90, 1), (180, 2), (-90, 3), (270, 3)]
)
def test_images_are_turned_by_the_nearest_quarter(roll_deg: float, quarters: int) -> None:
    assert nearest_quarter(roll_deg) == quarters


# Optical axes in a level base: x right, y down, z forward.
LEVEL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


@pytest.mark.parametrize('roll_deg', [-90, 0, 30, 90, 180])
@pytest.mark.parametrize('pitch_deg', [-45, 0, 45])
def test_the_roll_follows_from_the_place_of_the_camera_on_its_base(
    roll_deg: float, pitch_deg: float
) -> None:
    T = LEVEL.copy()
    for axis, angle_deg in ((0, -pitch_deg), (2, roll_deg)):  # of the camera, roll last
        turn = np.zeros(3)
        turn[axis] = np.deg2rad(angle_deg)
        T[:3, :3] = T[:3, :3] @ cv2.Rodrigues(turn)[0]
    found = mounted_roll_deg(T)
    assert (found - roll_deg + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)


def test_a_camera_that_looks_down_has_no_roll() -> None:
    down = np.array([[0.0, -1, 0, 0], [-1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
    assert mounted_roll_deg(down) == 0


@pytest.mark.parametrize('quarters', range(4))
def test_a_box_in_the_turned_image_is_that_of_the_image(quarters: int) -> None:
    image = np.zeros((48, 64, 3), np.uint8)
    image[5:20, 10:50] = 255
    rows, columns = np.nonzero(turned(image, quarters)[..., 0])
    box = np.array([[columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]], np.float32)
    np.testing.assert_array_equal(boxes_before_turn(box, quarters, (64, 48)), [[10, 5, 50, 20]])


@pytest.mark.skipif(not MODEL.is_file(), reason='needs the model of ../shared')
@pytest.mark.parametrize(
    ('roll_deg', 'code'),
    [
        (90, cv2.ROTATE_90_COUNTERCLOCKWISE),
        (180, cv2.ROTATE_180),
        (-90, cv2.ROTATE_90_CLOCKWISE),
    ],
)
def test_people_are_found_by_a_camera_that_is_mounted_turned(roll_deg: float, code: int) -> None:
    image = cv2.imread(str(SHARED / 'images' / 'bus.jpg'))
    assert image is not None
    expected = OnnxDetector(MODEL, DetectorConfig()).detect(image.astype(np.uint8), 0)
    mounted = OnnxDetector(MODEL, DetectorConfig(camera_roll_deg=roll_deg))
    seen = cv2.rotate(image, code)
    found = mounted.detect(seen.astype(np.uint8), 0)
    assert found.class_names == expected.class_names
    assert found.class_names.count('person') >= 3
    center = (found.boxes_xyxy_px[:, :2] + found.boxes_xyxy_px[:, 2:]) / 2
    upright = (expected.boxes_xyxy_px[:, :2] + expected.boxes_xyxy_px[:, 2:]) / 2
    height, width = image.shape[:2]
    x, y = upright.T
    where = {90: (y, width - x), 180: (width - x, height - y), -90: (height - y, x)}[int(roll_deg)]
    np.testing.assert_allclose(center, np.stack(where, axis=1), atol=1)
