"""The noise of tracked images: known noise is measured, and few residuals change nothing."""

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.mapping.mapper import KeyframeRequest
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.tracked_frame import TrackedFrame, tracked_frame
from rgbd_slam.optimize.measured_noise import NoiseEstimator, median
from rgbd_slam.slam import RgbdSlam

from .world import CAMERA as MODEL
from .world import PERIOD_NS, World, sway

CAMERA = StereoCamera.from_model(MODEL, SlamConfig().camera)
POINTS_M = np.random.default_rng(0).uniform([-1.5, -1, 2], [1.5, 1, 5], (600, 3))
OCTAVES = np.random.default_rng(1).integers(0, 8, len(POINTS_M)).astype(np.uint8)


class Images:
    """Images from a known pose of points whose positions in the map are exact."""

    def __init__(self, pixel_px: float, disparity: float, seed: int = 0) -> None:
        self.map = Atlas(1.2, 8)
        self._pixel_px, self._disparity = pixel_px, disparity
        self._rng = np.random.default_rng(seed)
        self._T_map_camera = se3.exp(np.array([0.1, -0.2, 0.05, 0.1, 0.2, -0.1]))
        first = self._frame(POINTS_M, CAMERA.project(POINTS_M))
        i = self.map.add_keyframe(first, self._T_map_camera, 0)
        self.j = self.map.add_points(
            i, np.arange(len(POINTS_M)), se3.transform(self._T_map_camera, POINTS_M)
        )

    def take(self, count: int = len(POINTS_M), *, depth: bool = True) -> TrackedFrame:
        """Return a tracked image in which some points were found, with noise."""
        exact = CAMERA.project(POINTS_M)
        disparity = exact[:, 0] - exact[:, 2]
        sigma_px = self._pixel_px * 1.2**OCTAVES
        noisy = exact + self._rng.normal(0, 1, exact.shape) * sigma_px[:, None]
        reading = disparity + self._rng.normal(0, 1, len(exact)) * (
            self._disparity * CAMERA.disparity_sigma_px(disparity)
        )
        noisy[:, 2] = noisy[:, 0] - reading if depth else np.nan
        points = np.where(np.arange(len(self.j)) < count, self.j, NO_POINT)
        frame = self._frame(POINTS_M, noisy)
        return tracked_frame(frame, self._T_map_camera, points, self.map, 0)

    def _frame(self, points_m: FloatArray, measured_px: FloatArray) -> Frame:
        n = len(points_m)
        return Frame(
            0,
            measured_px.astype(np.float32),
            np.where(np.isfinite(measured_px[:, 2]), points_m[:, 2], 0).astype(np.float32),
            OCTAVES,
            np.zeros(n, np.float32),
            np.zeros((n, 32), np.uint8),
            np.ones(n, np.bool_),
        )


def after(tracked: TrackedFrame, atlas: Atlas) -> StereoCamera:
    """Return the camera with the noise measured in one image."""
    noise = NoiseEstimator(CAMERA)
    noise.add(tracked, atlas)
    return noise.camera


@pytest.mark.parametrize(('pixel_px', 'disparity'), [(0.5, 0.2), (0.9, 1.0), (0.3, 2.0)])
def test_known_noise_is_measured(pixel_px: float, disparity: float) -> None:
    images, meter = Images(pixel_px, disparity), NoiseEstimator(CAMERA)
    for _ in range(300):
        meter.add(images.take(), images.map)
    camera = meter.camera
    assert camera.pixel_noise == pytest.approx(pixel_px, rel=0.1)
    assert camera.disparity_noise_px / CAMERA.disparity_noise_px == pytest.approx(
        disparity, rel=0.1
    )
    assert camera.relative_noise / CAMERA.relative_noise == pytest.approx(disparity, rel=0.1)


def test_the_first_image_is_averaged_with_the_configured_noise() -> None:
    images = Images(0.2, 0.2)
    camera = after(images.take(), images.map)
    assert 0.8 < camera.pixel_noise < 1.0
    assert 0.8 < camera.disparity_noise_px / CAMERA.disparity_noise_px < 1.0


def test_too_few_points_or_readings_change_nothing() -> None:
    images = Images(0.2, 0.2)
    assert after(images.take(10), images.map) == CAMERA
    camera = after(images.take(depth=False), images.map)
    assert camera.pixel_noise < 1.0
    assert camera.disparity_noise_px == CAMERA.disparity_noise_px


def test_tracking_and_mapping_use_the_noise_of_the_camera(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The world's camera reads depth five to ten times better than configured."""
    world, slam = World(), RgbdSlam(MODEL, SlamConfig())
    cameras: list[StereoCamera] = []
    insert = slam.map.mapper.insert

    def record(request: KeyframeRequest) -> object:
        cameras.append(request.measured_camera)
        return insert(request)

    monkeypatch.setattr(slam.map.mapper, 'insert', record)
    for n, pose in enumerate(sway(60)):
        slam.process(world.features(n * PERIOD_NS, pose))
    noise = [camera.disparity_noise_px for camera in cameras]
    assert len(noise) >= 2
    assert 0.25 < cameras[-1].pixel_noise < 0.6
    assert noise[-1] < 0.5 * CAMERA.disparity_noise_px
    assert noise[-1] < noise[0] < CAMERA.disparity_noise_px


@pytest.mark.parametrize('dtype', [np.float32, np.float64])
def test_the_median_is_exactly_that_of_numpy(dtype: type) -> None:
    rng = np.random.default_rng(2)
    for count in range(1, 200):
        values: FloatArray = rng.normal(0, 3, count).astype(dtype)
        assert median(values) == np.median(values)
    assert median(np.full(4, np.inf)) == np.inf
