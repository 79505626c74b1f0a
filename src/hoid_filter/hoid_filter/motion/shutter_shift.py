"""How far a rolling shutter shifts the first and last rows of images of a camera that turns."""

from __future__ import annotations

import numpy as np

from hoid_common.values import FloatArray

# Chosen: the readout time of a Kinect, 30.6 ms (Ringaby and Forssen, ICCV 2011), because the
# filter does not know the readout time of its camera. While a camera turns slowly, the shift of
# the image rows is below the other tolerances.
_READOUT_S = 0.03
# The least tolerance of a tracked point, 6 sigmas of 0.25 px. The measured noise already contains
# smaller shifts, and to count them again hides surface that moves slowly (decision 050).
_MIN_SHIFT_PX = 1.5


def shift_px(turn_radps: FloatArray, earlier_radps: FloatArray, focal_px: float) -> FloatArray:
    """Return the largest shift [px] (...) of a row between two images, against the middle row.

    Turn rates are (..., 3). A shift below 1.5 px counts as none, because the measured noise
    contains it.
    """
    change_radps = np.linalg.norm(turn_radps - earlier_radps, axis=-1)
    shift_px = 0.5 * _READOUT_S * focal_px * change_radps
    return np.where(shift_px < _MIN_SHIFT_PX, 0.0, shift_px)
