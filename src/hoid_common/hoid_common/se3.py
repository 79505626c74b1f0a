"""Rigid transforms, the group SE(3), as arrays of float64.

A transform is a homogeneous matrix `T_a_b`, which maps points of frame b to frame a; its
translation is in m. A twist is a rotation vector in rad, then a translation in m, as in GTSAM's
`Pose3`. Quaternions are x, y, z, w, as in ROS. The formulas are those of Barfoot, "State
Estimation for Robotics" (2017), chapter 7. No function but `is_rigid` checks its input.
"""

from __future__ import annotations

import numpy as np

from hoid_common.values import BoolArray, FloatArray

# Below this angle the second-order Taylor series replaces the closed form. The first omitted term
# is angle**4 / 120 < 1e-18, which is less than the resolution of float64 (2e-16).
_SMALL_ANGLE_RAD = 1e-4
# Lower limit of the sine of half the rotation angle in `log`: keeps quotients finite at the
# identity.
_MIN_HALF_ANGLE_SINE = 1e-12
_XYZ = np.arange(3)
# Chosen: largest entry of R R^T - I for a rotation R. Rounding errors add up to 1e-9 in days; an
# error of a millimeter at any point of a map is far larger.
_MAX_RIGID_ERROR = 1e-6

T_BODY_OPTICAL: FloatArray = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""Transform (4, 4) from optical axes (x right, y down, z forward) to body axes (x forward, y left,
z up) with the same origin, REP 103."""


def hat(w: FloatArray) -> FloatArray:
    """Return the skew-symmetric matrices W (..., 3, 3) of vectors w: W @ x = cross(w, x)."""
    out = np.zeros((*w.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    return out


def exp(twist: FloatArray) -> FloatArray:
    """Return the transforms (..., 4, 4) of twists (..., 6): the exponential map of SE(3)."""
    w, v = twist[..., :3], twist[..., 3:]
    angle = np.linalg.norm(w, axis=-1)[..., None, None]
    small = angle < _SMALL_ANGLE_RAD
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0 - angle**2 / 6, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle**2 / 24, 2 * (np.sin(safe / 2) / safe) ** 2)
    c = np.where(small, 1 / 6 - angle**2 / 120, (1 - a) / safe**2)
    W = hat(w)
    W2 = W @ W
    T = np.zeros((*twist.shape[:-1], 4, 4))
    T[..., :3, :3] = np.eye(3) + a * W + b * W2
    T[..., :3, 3] = ((np.eye(3) + b * W + c * W2) @ v[..., None])[..., 0]
    T[..., 3, 3] = 1.0
    return T


def log(T: FloatArray) -> FloatArray:
    """Return the twists (..., 6) of transforms (..., 4, 4), with a rotation angle in [0, pi]."""
    quat = quat_xyzw_from_rotation(T[..., :3, :3])
    quat *= np.copysign(1.0, quat[..., 3:])
    axis, cosine = quat[..., :3], quat[..., 3:]
    sine = np.maximum(np.sqrt(np.vecdot(axis, axis)), _MIN_HALF_ANGLE_SINE)[..., None]
    half = np.arctan2(sine, cosine)
    w = 2 * half / sine * axis
    # Near the identity k suffers from cancellation, but it multiplies W @ W, which is tiny there.
    k = (1 - half * cosine / sine) / (2 * half) ** 2
    W = hat(w)
    V_inv = np.eye(3) - 0.5 * W + k[..., None] * (W @ W)
    return np.concatenate([w, (V_inv @ T[..., :3, 3:])[..., 0]], axis=-1)


def inverse(T: FloatArray) -> FloatArray:
    """Return the inverse transforms T_b_a (..., 4, 4) of T_a_b (..., 4, 4).

    The inverse rotation is the transpose, so that its rounding error triples each time that A @
    (inverse(A) @ B) replaces A. Use `orthonormalized` on poses that are chained like this.
    """
    out = np.zeros(T.shape)
    R_t = T[..., :3, :3].swapaxes(-1, -2)
    out[..., :3, :3] = R_t
    out[..., :3, 3:] = -(R_t @ T[..., :3, 3:])
    out[..., 3, 3] = 1.0
    return out


def adjoint(T_a_b: FloatArray) -> FloatArray:
    """Return the adjoint matrix (6, 6) of T_a_b (4, 4): it maps a twist of frame b to frame a.

    exp(adjoint(T) @ x) = T @ exp(x) @ inverse(T).
    """
    R = T_a_b[:3, :3]
    A = np.zeros((6, 6))
    A[:3, :3] = A[3:, 3:] = R
    A[3:, :3] = hat(T_a_b[:3, 3]) @ R
    return A


def transform(T_a_b: FloatArray, points_b: FloatArray) -> FloatArray:
    """Return the coordinates (N, 3) in frame a of points (N, 3) given in frame b."""
    return points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def is_rigid(T: FloatArray) -> BoolArray:
    """Return whether matrices (..., 4, 4) are finite and their rotations orthonormal to 1e-6."""
    R = T[..., :3, :3]
    with np.errstate(invalid='ignore', over='ignore'):  # comparisons with NaN are false
        error = np.abs(R @ R.swapaxes(-1, -2) - np.eye(3)).max((-2, -1))
        is_rotation = (error < _MAX_RIGID_ERROR) & (np.linalg.det(R) > 0)
    is_finite = np.isfinite(T[..., :3, 3]).all(-1)
    return np.asarray(is_rotation & is_finite & (T[..., 3, :] == (0, 0, 0, 1)).all(-1))


def orthonormalized(T: FloatArray) -> FloatArray:
    """Return T (..., 4, 4) with the nearest rotation in SO(3), from which products drift away.

    It is U diag(1, 1, det(U V^T)) V^T, the nearest in the Frobenius norm (Kabsch, 1976).
    """
    u, _, vt = np.linalg.svd(T[..., :3, :3])
    u[..., :, 2] *= np.linalg.det(u @ vt)[..., None]
    out = T.copy()
    out[..., :3, :3] = u @ vt
    return out


def quat_xyzw_from_rotation(R: FloatArray) -> FloatArray:
    """Return the unit quaternions (..., 4) of rotations (..., 3, 3), by Shepperd's method (1978).

    The method divides by the largest component, so that it is precise for every rotation.
    """
    transposed = R.swapaxes(-1, -2)
    diagonal = R[..., _XYZ, _XYZ]
    trace = diagonal.sum(-1, keepdims=True)
    # Row i is the quaternion multiplied by 4 q_i; the row of the largest q_i is the most precise.
    rows = np.empty((*R.shape[:-2], 4, 4))
    rows[..., :3, :3] = R + transposed
    rows[..., _XYZ, _XYZ] = 1 + 2 * diagonal - trace
    rows[..., :3, 3] = rows[..., 3, :3] = (R - transposed)[..., [2, 0, 1], [1, 2, 0]]
    rows[..., 3, 3] = 1 + trace[..., 0]
    largest = rows.diagonal(axis1=-2, axis2=-1).argmax(-1)
    quat = np.take_along_axis(rows, largest[..., None, None], axis=-2)[..., 0, :]
    return np.asarray(quat / np.sqrt(np.vecdot(quat, quat))[..., None])


def rotation_from_quat_xyzw(quat_xyzw: FloatArray) -> FloatArray:
    """Return the rotations (..., 3, 3) of quaternions (..., 4) of any non-zero norm."""
    q = quat_xyzw / np.linalg.norm(quat_xyzw, axis=-1, keepdims=True)
    V = hat(q[..., :3])
    return np.asarray(np.eye(3) + 2 * q[..., 3, None, None] * V + 2 * (V @ V))


def from_quat_translation(quat_xyzw: FloatArray, translation_m: FloatArray) -> FloatArray:
    """Return T_a_b (..., 4, 4) of quaternions (..., 4) with norm > 0, and translations in m."""
    T = np.zeros((*quat_xyzw.shape[:-1], 4, 4))
    T[..., :3, :3] = rotation_from_quat_xyzw(quat_xyzw)
    T[..., :3, 3] = translation_m
    T[..., 3, 3] = 1.0
    return T
