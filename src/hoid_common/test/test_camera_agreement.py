"""Which camera is believed, by what is said and what the images are."""

from dataclasses import replace

import pytest

from hoid_common.errors import MessageError
from hoid_common.inputs.camera_agreement import CameraAgreement
from hoid_common.values import CameraModel

RIGHT = CameraModel(640, 480, 500.0, 500.0, 320.0, 240.0)
TWICE = CameraModel(1280, 960, 1000.0, 1000.0, 640.0, 480.0)
OTHER = replace(RIGHT, fx_px=700.0)
SIZE = RIGHT.size_px


def proved() -> CameraAgreement:
    """With the right camera in use for long."""
    agreement = CameraAgreement()
    assert agreement.offer(RIGHT)
    for _ in range(100):
        agreement.check_image(SIZE)
    return agreement


def test_the_first_camera_is_used_at_once_and_once() -> None:
    agreement = CameraAgreement()
    assert [agreement.offer(RIGHT) for _ in range(3)] == [True, False, False]
    assert agreement.camera == RIGHT
    assert agreement.complaint == ''


def test_a_first_camera_of_another_size_gives_way_to_the_right_one() -> None:
    agreement = CameraAgreement()
    assert agreement.offer(TWICE)
    for _ in range(50):  # however many images come before
        with pytest.raises(MessageError, match='1280x960 px, images are of 640x480 px'):
            agreement.check_image(SIZE)
    assert '1280x960' in agreement.complaint
    assert not agreement.offer(TWICE)
    assert agreement.complaint
    assert agreement.offer(RIGHT)
    agreement.check_image(SIZE)
    assert (agreement.camera, agreement.complaint) == (RIGHT, '')


def test_a_first_camera_that_is_contradicted_gives_way() -> None:
    agreement = CameraAgreement()
    agreement.offer(OTHER)
    agreement.check_image(SIZE)
    assert not agreement.offer(RIGHT)  # it may be this one that is wrong
    agreement.check_image(SIZE)
    assert agreement.offer(RIGHT)
    assert agreement.camera == RIGHT


@pytest.mark.parametrize('stray', [TWICE, OTHER])
def test_a_stray_camera_changes_nothing_and_is_forgotten(stray: CameraModel) -> None:
    agreement = proved()
    for _ in range(5):
        assert not agreement.offer(stray)
        assert agreement.complaint
        agreement.check_image(SIZE)
    assert not agreement.offer(RIGHT)
    assert (agreement.camera, agreement.complaint) == (RIGHT, '')


def test_images_that_change_their_size_are_refused_until_the_camera_follows() -> None:
    agreement = proved()
    with pytest.raises(MessageError):
        agreement.check_image(TWICE.size_px)
    assert agreement.offer(TWICE)
    agreement.check_image(TWICE.size_px)
    assert agreement.complaint == ''
