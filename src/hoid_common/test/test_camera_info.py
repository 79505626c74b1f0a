"""Cameras from camera_info: raw and rectified images, binning, regions, lens models."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import pytest

from hoid_common.errors import MessageError
from hoid_common.io.camera_info import camera_from_info, rectification_doubt
from hoid_common.values import CameraModel


def _no_roi() -> Any:
    return SimpleNamespace(x_offset=0, y_offset=0, width=0, height=0)


@dataclass
class Info:
    """The fields of sensor_msgs/CameraInfo of a calibrated camera with distortion."""

    width: int = 640
    height: int = 480
    distortion_model: str = 'plumb_bob'
    d: tuple[float, ...] = (0.2, -0.5, 0.001, 0.002, 0.1)
    k: tuple[float, ...] = (517.0, 0, 318.0, 0, 516.0, 255.0, 0, 0, 1)
    p: tuple[float, ...] = (470.0, 0, 322.0, 0, 0, 471.0, 250.0, 0, 0, 0, 1, 0)
    binning_x: int = 0
    binning_y: int = 0
    roi: Any = field(default_factory=_no_roi)


RAW = CameraModel(640, 480, 517, 516, 318, 255, Info.d)
RECTIFIED = CameraModel(640, 480, 470, 471, 322, 250)


@pytest.mark.parametrize(
    ('topic', 'expected'),
    [
        ('', RAW),
        ('/camera/color/image_raw', RAW),
        ('/camera/color/image_rect_color', RECTIFIED),
        ('/camera/rgb/image_rect/compressed', RECTIFIED),
        ('/zed/zed_node/rgb/color/rect/image', RECTIFIED),
        ('/direct/image', RAW),
    ],
)
def test_rectified_topics_have_the_camera_of_p(topic: str, expected: CameraModel) -> None:
    assert camera_from_info(Info(), topic) == expected


def test_a_topic_whose_name_does_not_tell_is_warned_of() -> None:
    assert 'is taken as not rectified' in rectification_doubt(Info(), '/camera/image')
    assert rectification_doubt(Info(), '/camera/image_raw') == ''
    assert rectification_doubt(Info(), '/camera/image_rect') == ''
    assert rectification_doubt(replace(Info(), p=(517.0, *Info.p[1:])), '/camera/image') == ''
    without_p = replace(Info(), p=(0.0,) * 12)
    assert 'no matrix P' in rectification_doubt(without_p, '/camera/image_rect')


def test_binning_and_region_of_interest_are_applied() -> None:
    roi = SimpleNamespace(x_offset=100, y_offset=40, width=400, height=300)
    camera = camera_from_info(replace(Info(), binning_x=2, binning_y=2, roi=roi))
    assert camera == CameraModel(200, 150, 258.5, 258, 109, 107.5, Info.d)


@pytest.mark.parametrize(
    ('model', 'd', 'is_fisheye'),
    [
        ('rational_polynomial', (0.1,) * 8, False),
        ('rational_polynomial', (0.1,) * 12, False),
        ('rational_polynomial', (*(0.1,) * 8, *(0.0,) * 6), False),
        ('equidistant', (0.1, 0.01, 0.001, 0.0), True),
        ('equidistant', (0.0,) * 4, False),
    ],
)
def test_lens_models_of_drivers(model: str, d: tuple[float, ...], is_fisheye: bool) -> None:
    camera = camera_from_info(replace(Info(), distortion_model=model, d=d))
    assert camera.is_fisheye == is_fisheye
    assert camera.distortion == (d if any(d) else ())


def test_unknown_lens_models_are_refused() -> None:
    with pytest.raises(MessageError, match='distortion_model "mei"; use one of plumb_bob'):
        camera_from_info(replace(Info(), distortion_model='mei'))
