"""A screen with a moving picture in a recording: where it is, and that it is at rest in depth."""

import numpy as np

from hoid_benchmarks.plan.moving_picture import MovingPicture
from hoid_common import se3
from hoid_common.values import CameraModel, FloatArray, RgbdFrame, Trajectory

CAMERA = CameraModel(320, 240, 250.0, 250.0, 160.0, 120.0)
WIDTH_M = 0.4
START_NS, LATER_NS = 1_000_000_000, 2_000_000_000


def frame(stamp_ns: int, depth_m: float) -> RgbdFrame:
    return RgbdFrame(
        stamp_ns, np.zeros((240, 320, 3), np.uint8), np.full((240, 320), depth_m, np.float32)
    )


def screen(T_second: FloatArray) -> MovingPicture:
    poses = np.stack([np.eye(4), T_second])
    return MovingPicture(CAMERA, Trajectory(np.array([START_NS, LATER_NS]), poses), WIDTH_M)


def test_the_screen_stands_before_the_first_camera() -> None:
    shown = screen(np.eye(4)).painted(frame(START_NS, 2.0))
    is_screen = shown.depth_m < 1.9
    np.testing.assert_allclose(shown.depth_m[is_screen], 0.8, atol=1e-6)
    rows, columns = np.nonzero(is_screen)
    assert abs(np.ptp(columns) + 1 - 250 * WIDTH_M / 0.8) <= 1  # 125 px wide
    assert abs(np.ptp(rows) + 1 - 250 * WIDTH_M * 9 / 16 / 0.8) <= 1
    assert abs(columns.mean() - 160) <= 0.5
    assert shown.image_bgr[is_screen].std() > 50
    assert not shown.image_bgr[~is_screen].any()


def test_the_picture_moves_and_its_depth_does_not() -> None:
    picture = screen(np.eye(4))
    first, later = (picture.painted(frame(stamp, 2.0)) for stamp in (START_NS, LATER_NS))
    np.testing.assert_array_equal(first.depth_m, later.depth_m)
    # It moves by 0.1 m in a second to the left: 31.25 px at 0.8 m.
    left, right = later.image_bgr[120, 105:185], first.image_bgr[120, 136:216]
    assert np.abs(left.astype(int) - right).mean() < 15
    assert np.abs(left.astype(int) - first.image_bgr[120, 105:185]).mean() > 40


def test_the_screen_stays_in_the_room_while_the_camera_moves() -> None:
    T_second = se3.exp(np.array([0.0, 0.0, 0.0, 0.1, 0.0, -0.2]))  # to the right, and back
    shown = screen(T_second).painted(frame(LATER_NS, 2.0))
    is_screen = shown.depth_m < 1.9
    np.testing.assert_allclose(shown.depth_m[is_screen], 1.0, atol=1e-6)
    assert abs(np.nonzero(is_screen)[1].mean() - (160 - 250 * 0.1 / 1.0)) <= 0.5


def test_what_is_nearer_hides_the_screen() -> None:
    near = frame(START_NS, 0.5)
    shown = screen(np.eye(4)).painted(near)
    np.testing.assert_array_equal(shown.image_bgr, near.image_bgr)
    np.testing.assert_array_equal(shown.depth_m, near.depth_m)
