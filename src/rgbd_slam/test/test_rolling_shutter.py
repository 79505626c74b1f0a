"""A rolling shutter is estimated from tracking residuals and compensated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import S_PER_NS, Features, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.tracked_frame import tracked_frame
from rgbd_slam.slam import RgbdSlam
from rgbd_slam.tracking.rolling_shutter import MovingView, RollingShutter

from .world import CAMERA as MODEL
from .world import PERIOD_NS, World, position_errors_m

CAMERA = StereoCamera.from_model(MODEL, SlamConfig().camera)
READOUT_S = 0.025
TWIST = np.array([0.3, -0.4, 0.2, 0.3, -0.2, 0.25])
SWING = se3.exp(np.outer(1 - np.cos(np.linspace(0, 2 * np.pi, 90)), TWIST / 6))  # from rest


TURNED_WH = 480, 640  # an image that its driver has turned by a quarter


def rolled(
    features: Features, twist: FloatArray, readout_s: float, *, is_turned: bool = False
) -> Features:
    """Return features as a moving camera with a rolling shutter sees them.

    With `is_turned`, the rows of the sensor are the columns of the image.
    """
    axis, num_rows = (0, TURNED_WH[0]) if is_turned else (1, MODEL.height_px)
    uv, z = features.uv_px.astype(np.float64), features.depth_m.astype(np.float64)
    z = np.where(z > 0, z, 6.0)
    x = CAMERA.back_project(uv, z)
    for _ in range(5):  # a row's time is that of where the point is then
        late_s = readout_s * (uv[:, axis] / num_rows - 0.5)
        moved = x + late_s[:, None] * (np.cross(twist[:3], x) + twist[3:])
        uv = MODEL.project_px(moved)
    depth_m = np.where(features.depth_m > 0, moved[:, 2], 0)
    return replace(features, uv_px=uv.astype(np.float32), depth_m=depth_m.astype(np.float32))


def swayed(
    readout_s: float, known_s: float = 0.0, swings: int = 1, config: SlamConfig | None = None
) -> RgbdSlam:
    """Return the SLAM after tracking a swaying camera with a rolling shutter.

    `known_s` is the readout time that the SLAM assumes at the start.
    """
    world, slam = World(), RgbdSlam(MODEL, config or SlamConfig())
    slam._shutter.readout_s = known_s
    poses = np.concatenate([SWING] * swings)
    for n, pose in enumerate(poses):
        after = poses[min(n + 1, len(poses) - 1)]
        twist = se3.log(se3.inverse(after) @ pose) / (S_PER_NS * PERIOD_NS)
        slam.process(rolled(world.features(n * PERIOD_NS, pose), twist, readout_s))
    return slam


class Images:
    """Images of points that the map knows exactly, from known poses of a camera that shakes."""

    def __init__(self, readout_s: float, *, is_turned: bool = False) -> None:
        self._world, self._readout_s, self._is_turned = World(), readout_s, is_turned
        self._rng = np.random.default_rng(0)
        self.atlas = Atlas(1.2, 8)
        seen = Frame.from_features(self._world.features(0, np.eye(4), noise_px=0), MODEL, CAMERA)
        i = self.atlas.add_keyframe(seen, np.eye(4), 0)
        k = np.arange(len(seen))
        x = CAMERA.back_project(seen.measurement_px[:, :2], seen.depth_m)
        self._points = self.atlas.add_points(i, k, x)

    def show(self, shutter: RollingShutter, count: int, speed: float = 1.0) -> None:
        """Add images to a shutter's estimate, each taken by a camera of another velocity."""
        for _ in range(count):
            twist = speed * self._rng.normal(0, 0.3, 6)
            whole = self._world.features(0, np.eye(4))
            seen = rolled(whole, twist, self._readout_s, is_turned=self._is_turned)
            frame = Frame.from_features(seen, MODEL, CAMERA)
            straight = shutter.compensated(frame, CAMERA, twist)
            tracked = tracked_frame(straight, np.eye(4), self._points, self.atlas, 0)
            view = MovingView(tracked, self._points, np.eye(4), twist, is_measured=False)
            shutter.add(view, self.atlas, CAMERA)

    def show_to_gyro(self, shutter: RollingShutter, count: int) -> None:
        """Add images whose velocity a gyro knows, and whose matches do not fit the map."""
        for n in range(count):
            twist = self._rng.normal(0, 0.3, 6)
            whole = self._world.features(n * PERIOD_NS, np.eye(4))
            frame = Frame.from_features(rolled(whole, twist, self._readout_s), MODEL, CAMERA)
            straight = shutter.compensated(frame, CAMERA, twist)
            nothing = np.full_like(self._points, NO_POINT)
            tracked = tracked_frame(straight, np.eye(4), nothing, self.atlas, 0)
            view = MovingView(tracked, self._points, np.eye(4), twist, is_measured=True)
            shutter.add(view, self.atlas, CAMERA)


@pytest.mark.parametrize('readout_s', [READOUT_S, -READOUT_S])
def test_images_become_those_of_a_global_shutter(readout_s: float) -> None:
    seen = World().features(0, np.eye(4), noise_px=0)
    frame = Frame.from_features(rolled(seen, TWIST, readout_s), MODEL, CAMERA)
    expected = Frame.from_features(seen, MODEL, CAMERA)
    shutter = RollingShutter(*MODEL.size_px)
    shutter.readout_s = readout_s
    straight = shutter.compensated(frame, CAMERA, TWIST)
    before = np.abs(frame.measurement_px - expected.measurement_px)
    left = np.abs(straight.measurement_px - expected.measurement_px)
    assert np.nanmax(before) > 3
    assert np.nanmax(left) < 0.2
    assert np.abs(straight.depth_m - expected.depth_m).max() < 1e-3
    np.testing.assert_array_equal(straight.has_depth, expected.has_depth)


@pytest.mark.parametrize('readout_s', [READOUT_S, -READOUT_S, 0.01])
def test_a_readout_time_is_estimated(readout_s: float) -> None:
    images, shutter = Images(readout_s), RollingShutter(*MODEL.size_px)
    images.show(shutter, 39)
    assert shutter.readout_s == 0
    images.show(shutter, 81)
    assert shutter.readout_s == pytest.approx(readout_s, rel=0.08)


def test_the_rows_of_an_image_that_was_turned_are_its_columns() -> None:
    images = Images(READOUT_S, is_turned=True)
    turned, upright = RollingShutter(*TURNED_WH), RollingShutter(*MODEL.size_px)
    images.show(turned, 120)
    images.show(upright, 120)
    assert turned.readout_s == pytest.approx(READOUT_S, rel=0.08)
    assert upright.readout_s == 0


@pytest.mark.parametrize('readout_s', [READOUT_S, -READOUT_S, 0.01, 0.0])
def test_with_a_gyro_pairs_of_images_show_the_readout_time(readout_s: float) -> None:
    images, shutter = Images(readout_s), RollingShutter(*MODEL.size_px)
    images.show_to_gyro(shutter, 20)
    assert shutter.readout_s == 0
    images.show_to_gyro(shutter, 60)
    assert shutter.readout_s == pytest.approx(readout_s, rel=0.08)
    Images(-0.02).show(shutter, 120)  # from now on, residuals of map points do not count
    assert shutter.readout_s == pytest.approx(readout_s, rel=0.08)


@pytest.mark.parametrize(('readout_s', 'speed'), [(0.0, 1.0), (0.002, 1.0), (READOUT_S, 1e-3)])
def test_a_global_shutter_and_a_camera_at_rest_are_left_alone(
    readout_s: float, speed: float
) -> None:
    images, shutter = Images(readout_s), RollingShutter(*MODEL.size_px)
    images.show(shutter, 120, speed)
    assert shutter.readout_s == 0


@pytest.mark.slow
def test_it_is_estimated_in_a_map_of_rolling_shutter_images() -> None:
    assert 0.5 * READOUT_S < swayed(READOUT_S, swings=2)._shutter.readout_s < READOUT_S


@pytest.mark.slow
def test_the_estimation_can_be_switched_off() -> None:
    camera = replace(SlamConfig().camera, rolling_shutter=False)
    slam = swayed(READOUT_S, swings=2, config=replace(SlamConfig(), camera=camera))
    assert slam._shutter.readout_s == 0


@pytest.mark.slow
def test_compensation_improves_poses() -> None:
    known, unknown = (swayed(READOUT_S, s).trajectory.online() for s in (READOUT_S, 0.0))
    error_m = np.mean(position_errors_m(known, SWING))
    assert error_m < 0.4 * np.mean(position_errors_m(unknown, SWING))


def test_nothing_is_compensated_before_the_estimate_is_significant() -> None:
    frame = Frame.from_features(World().features(0, np.eye(4)), MODEL, CAMERA)
    assert RollingShutter(*MODEL.size_px).compensated(frame, CAMERA, TWIST) is frame
