"""The right calibration is used if camera_info messages contradict each other or the images."""

from dataclasses import replace

import pytest

from hoid_common.errors import MessageError
from hoid_common.inputs.camera_info_check import CameraInfoCheck
from hoid_common.values import CameraModel

RIGHT = CameraModel(640, 480, 500.0, 500.0, 320.0, 240.0)
TWICE = CameraModel(1280, 960, 1000.0, 1000.0, 640.0, 480.0)
LARGER = CameraModel(960, 720, 750.0, 750.0, 480.0, 360.0)  # by no whole number
OTHER = replace(RIGHT, fx_px=700.0)
SIZE = RIGHT.size_px
REMEDY = 'begin anew'


def with_kept_calibration() -> CameraInfoCheck:
    """Return a check that has used the right calibration for longer than its trial."""
    check = CameraInfoCheck(REMEDY)
    assert check.update(RIGHT)
    for _ in range(100):
        check.check_image(SIZE)
    return check


def test_first_calibration_is_used_at_once_and_reported_once() -> None:
    check = CameraInfoCheck(REMEDY)
    assert [check.update(RIGHT) for _ in range(3)] == [True, False, False]
    assert check.camera == RIGHT
    assert check.problem == ''


def test_first_calibration_of_wrong_size_is_replaced() -> None:
    check = CameraInfoCheck(REMEDY)
    assert check.update(LARGER)
    for _ in range(50):
        with pytest.raises(MessageError, match='960x720 px, images are of 640x480 px'):
            check.check_image(SIZE)
    assert '960x720' in check.problem
    assert not check.update(LARGER)
    assert check.problem
    assert check.update(RIGHT)
    check.check_image(SIZE)
    assert (check.camera, check.problem) == (RIGHT, '')


def test_calibration_on_trial_is_replaced_after_two_messages() -> None:
    check = CameraInfoCheck(REMEDY)
    check.update(OTHER)
    check.check_image(SIZE)
    assert not check.update(RIGHT)  # a single message may be wrong
    assert 'the first is kept, until this is repeated' in check.problem
    check.check_image(SIZE)
    assert check.update(RIGHT)
    assert check.camera == RIGHT
    assert 'the second is used for all images' in check.problem
    assert not check.update(RIGHT)
    assert check.problem == ''


@pytest.mark.parametrize('stray', [TWICE, OTHER])
def test_another_calibration_after_the_trial_is_only_reported(stray: CameraModel) -> None:
    check = with_kept_calibration()
    for _ in range(5):
        assert not check.update(stray)
        assert check.problem
        check.check_image(SIZE)
    assert not check.update(RIGHT)
    assert (check.camera, check.problem) == (RIGHT, '')


def test_the_map_of_a_kept_calibration_outlives_images_of_another_size() -> None:
    check = with_kept_calibration()
    with pytest.raises(MessageError, match=r'camera_info is of 640x480 px.*: begin anew'):
        check.check_image(TWICE.size_px)
    assert not check.update(TWICE)
    assert 'has changed from 640x480 px, fx 500.0' in check.problem
    assert check.problem.endswith('begin anew')
    check.update(RIGHT)
    check.check_image(SIZE)
    assert (check.camera, check.problem) == (RIGHT, '')


@pytest.mark.parametrize('is_first', [True, False])
def test_a_calibration_of_a_multiple_size_is_scaled_and_said(is_first: bool) -> None:
    check = CameraInfoCheck(REMEDY)
    if is_first:
        assert check.update(TWICE)
        assert check.check_image(SIZE)  # the calibration in use has changed
    else:
        assert not check.check_image(SIZE)
        assert check.update(TWICE)
    expected = CameraModel(640, 480, 500.0, 500.0, 319.75, 239.75)
    assert check.camera == expected
    for _ in range(100):
        assert not check.check_image(SIZE)
        assert not check.update(TWICE)
    assert check.camera == expected
    assert 'camera_info is of 1280x960 px, images are of 640x480 px' in check.problem
    assert 'it is scaled to them' in check.problem


def test_a_calibration_of_the_right_size_replaces_a_scaled_one() -> None:
    check = CameraInfoCheck(REMEDY)
    check.update(TWICE)
    check.check_image(SIZE)
    assert check.update(RIGHT)
    check.check_image(SIZE)
    assert (check.camera, check.problem) == (RIGHT, '')


def test_the_calibration_that_a_scaled_one_equals_is_no_problem() -> None:
    check = CameraInfoCheck(REMEDY)
    check.update(TWICE)
    check.check_image(SIZE)
    assert check.camera is not None
    assert check.problem
    assert not check.update(check.camera)
    assert check.problem == ''
    assert not check.update(TWICE)
    assert 'it is scaled to them' in check.problem


def test_cameras_are_scaled_about_the_border_of_the_image() -> None:
    third = CameraModel(213, 160, 170.0, 171.0, 106.0, 79.5)
    assert third.scaled_to((639, 480)) == CameraModel(639, 480, 510.0, 513.0, 319.0, 239.5)
    assert CameraModel(639, 480, 510.0, 513.0, 319.0, 239.5).scaled_to((213, 160)) == third
    assert [third.scaled_to(size) for size in ((640, 480), (426, 480), (0, 0))] == [None] * 3
