"""Arrays of rotations and rotation vectors, and robust weights of residuals."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray


def rotations(vectors_rad: FloatArray) -> FloatArray:
    """Return the rotations (..., 3, 3) of rotation vectors (..., 3)."""
    return se3.exp(np.concatenate([vectors_rad, np.zeros(vectors_rad.shape)], axis=-1))[
        ..., :3, :3
    ]


def rotation_vector(R: FloatArray) -> FloatArray:
    """Return the rotation vectors (..., 3) [rad] of rotations (..., 3, 3)."""
    T = np.zeros((*R.shape[:-2], 4, 4))
    T[..., :3, :3], T[..., 3, 3] = R, 1.0
    return se3.log(T)[..., :3]


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) that is nearest to a matrix (3, 3)."""
    T = np.eye(4)
    T[:3, :3] = matrix
    return se3.orthonormalized(T)[:3, :3]


def cauchy_weights(lengths: FloatArray, median_factor: float, least: float) -> FloatArray:
    """Return the weights (N,) of a Cauchy kernel for residuals of these lengths (N,).

    The weight is 0.5 at `median_factor` times the median length, or at `least` if that is more.
    """
    limit = max(median_factor * float(np.median(lengths)), least)
    return np.asarray(1.0 / (1.0 + np.square(lengths / limit)))
