"""A rolling shutter is estimated from pairs of images and compensated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import S_PER_NS, Features, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
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
    """Images of the same points from known poses of a camera that shakes."""

    def __init__(
        self, readout_s: float, *, speed: float = 1.0, gyro: bool = False, turned: bool = False
    ) -> None:
        self._readout_s, self._speed = readout_s, speed
        self._has_gyro, self._is_turned = gyro, turned
        self._rng, self._num_shown = np.random.default_rng(0), 0
        self._seen = World().features(0, np.eye(4), noise_px=0)
        self._points_m = CAMERA.back_project(self._seen.uv_px, self._seen.depth_m)
        self._scale = Atlas(1.2, 8).octave_scale

    def _pose(self, time_s: float) -> FloatArray:
        phases = 2 * np.pi * time_s * np.linspace(1.3, 2.8, 6)
        return np.asarray(se3.exp(self._speed * 0.03 * np.sin(phases)))

    def show(self, shutter: RollingShutter, count: int) -> None:
        for n in range(self._num_shown, self._num_shown + count):
            time_s = S_PER_NS * n * PERIOD_NS
            pose, after = self._pose(time_s), self._pose(time_s + 1e-3)
            twist = se3.log(se3.inverse(after) @ pose) / 1e-3
            x = se3.transform(se3.inverse(pose), self._points_m)
            uv = MODEL.project_px(x) + self._rng.normal(0, 0.3, (len(x), 2))
            seen = replace(
                self._seen,
                stamp_ns=n * PERIOD_NS,
                uv_px=uv.astype(np.float32),
                depth_m=x[:, 2].astype(np.float32),
            )
            seen = rolled(seen, twist, self._readout_s, is_turned=self._is_turned)
            frame = Frame.from_features(seen, MODEL, CAMERA)
            rate_radps = -twist[:3] if self._has_gyro else None
            view = MovingView(frame, np.arange(len(x)), pose, rate_radps)
            shutter.add(view, CAMERA, self._scale)
        self._num_shown += count


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


@pytest.mark.parametrize('gyro', [False, True])
@pytest.mark.parametrize('readout_s', [READOUT_S, -READOUT_S, 0.01])
def test_a_readout_time_is_estimated(readout_s: float, gyro: bool) -> None:
    images, shutter = Images(readout_s, gyro=gyro), RollingShutter(*MODEL.size_px)
    images.show(shutter, 6)
    assert shutter.readout_s == 0
    images.show(shutter, 60)
    assert shutter.readout_s == pytest.approx(readout_s, rel=0.1)


def test_the_rows_of_an_image_that_was_turned_are_its_columns() -> None:
    turned, upright = RollingShutter(*TURNED_WH), RollingShutter(*MODEL.size_px)
    Images(READOUT_S, turned=True).show(turned, 66)
    Images(READOUT_S, turned=True).show(upright, 66)
    assert turned.readout_s == pytest.approx(READOUT_S, rel=0.1)
    assert upright.readout_s == 0


@pytest.mark.parametrize(('readout_s', 'speed'), [(0.0, 1.0), (0.002, 1.0), (READOUT_S, 1e-3)])
def test_a_global_shutter_and_a_camera_at_rest_are_left_alone(
    readout_s: float, speed: float
) -> None:
    shutter = RollingShutter(*MODEL.size_px)
    Images(readout_s, speed=speed).show(shutter, 120)
    assert shutter.readout_s == 0


@pytest.mark.slow
def test_it_is_estimated_in_a_map_of_rolling_shutter_images() -> None:
    assert swayed(READOUT_S, swings=2)._shutter.readout_s == pytest.approx(READOUT_S, rel=0.25)


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
