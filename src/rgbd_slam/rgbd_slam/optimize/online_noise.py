"""How noisy pixels and depth readings are, told from how well tracked images fit the map.

The configured noise suits any depth camera and is therefore cautious. What pixels say against
depth readings, and from where on residuals count less, differs by camera, distance and blur: it is
measured in each image and averaged over the last ones.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.projection import to_camera
from rgbd_slam.model.tracked_frame import TrackedFrame
from rgbd_slam.optimize.residual_noise import noise_factor

_MIN_RESIDUALS = 50  # in an image
_PRIOR = 3  # images that the configured noise counts as
_MEMORY = 100  # images


class OnlineNoise:
    """Averages over images the variances of pixels and disparities, in units of the configured.

    Args:
        camera: With the configured noise.
    """

    def __init__(self, camera: StereoCamera) -> None:
        self.camera = camera  # with the noise so far
        self._configured = camera
        self._variances = np.ones(2)
        self._num_images = _PRIOR

    def add(self, tracked: TrackedFrame, atlas: Atlas) -> None:
        """Take what an image saw of the map."""
        self._num_images = min(self._num_images + 1, _MEMORY)
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
        """Return (2,) standard deviations of pixels and disparities; NaN where too few tell it."""
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


def _factor(normalised: FloatArray) -> float:
    return noise_factor(normalised) if normalised.size >= _MIN_RESIDUALS else np.nan
