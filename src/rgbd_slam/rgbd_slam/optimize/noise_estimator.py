"""The noise of pixels and depth readings, measured from the residuals of tracked frames.

The configured noise holds for any depth camera and is therefore large. The true ratio of pixel to
depth noise, which weights them against each other and scales the robust kernels, depends on the
camera, the distance and blur. It is measured in each image and averaged (decision 003).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera, to_camera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.tracked_frame import TrackedFrame
from rgbd_slam.optimize.residual_noise import noise_factor

# Not tuned.
_MIN_RESIDUALS = 50  # with fewer residuals, the noise of an image is not measured
_PRIOR_IMAGES = 3  # weight of the configured noise, in images
_MAX_IMAGES = 100  # about three seconds: number of images over which the variances are averaged


class NoiseEstimator:
    """Averages the variances of pixels and disparities over about the last 100 tracked frames."""

    def __init__(self, camera: StereoCamera) -> None:
        self.camera = camera  # with the measured noise
        self._configured = camera
        self._variances = np.ones(2)  # of pixels and disparities, relative to the configured
        self._num_images = _PRIOR_IMAGES

    def add(self, tracked: TrackedFrame, atlas: Atlas) -> None:
        """Update the measured noise of `camera` with the residuals of a tracked frame."""
        self._num_images = min(self._num_images + 1, _MAX_IMAGES)
        step = self._factors(tracked, atlas) ** 2 - self._variances
        self._variances += np.nan_to_num(step) / self._num_images
        pixel, disparity = np.sqrt(self._variances).tolist()
        camera = self._configured
        self.camera = replace(
            camera,
            pixel_noise=pixel * camera.pixel_noise,
            disparity_noise_px=disparity * camera.disparity_noise_px,
            relative_noise=disparity * camera.relative_noise,
        )

    def _factors(self, tracked: TrackedFrame, atlas: Atlas) -> FloatArray:
        """Return the noise of pixels and of disparities as factors (2,) on the configured noise.

        A factor is NaN if there are too few residuals.
        """
        k = np.flatnonzero(tracked.points != NO_POINT)
        position_m = atlas.points.position_m.take(tracked.points[k], 0)
        x = to_camera(se3.inverse(tracked.T_map_camera), position_m.T)
        expected = self._configured.project_rows(x)
        measured = tracked.frame.measurement_px.take(k, 0).T
        residual = measured - expected
        pixel = residual[:2] / atlas.octave_scale[tracked.frame.octave[k]]
        sigma_px = self._configured.disparity_sigma_px(measured[0] - measured[2])
        disparity = (residual[0] - residual[2]) / sigma_px
        return np.array([_factor(pixel), _factor(disparity[np.isfinite(disparity)])])


def _factor(normalized: FloatArray) -> float:
    return noise_factor(normalized) if normalized.size >= _MIN_RESIDUALS else np.nan
