"""Rigid transforms as (..., 4, 4) arrays; twists are (..., 6), rotation (rad) first, then m.

Formulas: Barfoot, State Estimation for Robotics, ch. 7; all functions take whole arrays.
"""

from __future__ import annotations

import numpy as np

from hoid_common.values import FloatArray

_SMALL_ANGLE_RAD = 1e-4  # series of two terms are exact below
_NO_ANGLE_RAD = 1e-12  # below, an axis counts as turned by this: quotients stay finite
_XYZ = np.arange(3)


def hat(w: FloatArray) -> FloatArray:
    """Return the (..., 3, 3) skew matrices of (..., 3) vectors, for which W @ x = cross(w, x)."""
    out = np.zeros((*w.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = w[..., 2], -w[..., 1], w[..., 0]
    return out


def exp(twist: FloatArray) -> FloatArray:
    """Return the transforms (..., 4, 4) of twists (..., 6): rotation vector, then translation."""
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
    """Return the twists (..., 6) of transforms (..., 4, 4); the rotation angle is in [0, pi]."""
    quat = quat_xyzw_from_rotation(T[..., :3, :3])
    quat *= np.copysign(1.0, quat[..., 3:])
    axis, cosine = quat[..., :3], quat[..., 3:]
    sine = np.maximum(np.sqrt(np.vecdot(axis, axis)), _NO_ANGLE_RAD)[..., None]
    half = np.arctan2(sine, cosine)
    w = 2 * half / sine * axis
    k = (1 - half * cosine / sine) / (2 * half) ** 2  # its error does not matter: W @ W is small
    W = hat(w)
    V_inv = np.eye(3) - 0.5 * W + k[..., None] * (W @ W)
    return np.concatenate([w, (V_inv @ T[..., :3, 3:])[..., 0]], axis=-1)


def inverse(T: FloatArray) -> FloatArray:
    """Return the inverse transforms of (..., 4, 4)."""
    out = np.zeros(T.shape)
    R_t = T[..., :3, :3].swapaxes(-1, -2)
    out[..., :3, :3] = R_t
    out[..., :3, 3:] = -(R_t @ T[..., :3, 3:])
    out[..., 3, 3] = 1.0
    return out


def adjoint(T_a_b: FloatArray) -> FloatArray:
    """Return (6, 6) that turns small motions, rotation first, of frame b into those of frame a."""
    R = T_a_b[:3, :3]
    A = np.zeros((6, 6))
    A[:3, :3] = A[3:, 3:] = R
    A[3:, :3] = hat(T_a_b[:3, 3]) @ R
    return A


def transform(T_a_b: FloatArray, points_b: FloatArray) -> FloatArray:
    """Return (N, 3) points of frame b in frame a."""
    return points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def orthonormalized(T: FloatArray) -> FloatArray:
    """Return (4, 4) with the rotation projected to SO(3); chained products drift without it."""
    u, _, vt = np.linalg.svd(T[:3, :3])
    out = T.copy()
    out[:3, :3] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return out


def quat_xyzw_from_rotation(R: FloatArray) -> FloatArray:
    """Return unit quaternions (..., 4), x y z w, of rotations (..., 3, 3) (Shepperd's method)."""
    transposed = R.swapaxes(-1, -2)
    diagonal = R[..., _XYZ, _XYZ]
    trace = diagonal.sum(-1, keepdims=True)
    # Row i is the quaternion times four times its component i; the largest one divides best.
    rows = np.empty((*R.shape[:-2], 4, 4))
    rows[..., :3, :3] = R + transposed
    rows[..., _XYZ, _XYZ] = 1 + 2 * diagonal - trace
    rows[..., :3, 3] = rows[..., 3, :3] = (R - transposed)[..., [2, 0, 1], [1, 2, 0]]
    rows[..., 3, 3] = 1 + trace[..., 0]
    largest = rows.diagonal(axis1=-2, axis2=-1).argmax(-1)
    quat = np.take_along_axis(rows, largest[..., None, None], axis=-2)[..., 0, :]
    return np.asarray(quat / np.sqrt(np.vecdot(quat, quat))[..., None])


def rotation_from_quat_xyzw(quat_xyzw: FloatArray) -> FloatArray:
    """Return rotations (..., 3, 3) of quaternions (..., 4) of any non-zero norm."""
    q = quat_xyzw / np.linalg.norm(quat_xyzw, axis=-1, keepdims=True)
    V = hat(q[..., :3])
    return np.asarray(np.eye(3) + 2 * q[..., 3, None, None] * V + 2 * (V @ V))


def from_quat_translation(quat_xyzw: FloatArray, translation_m: FloatArray) -> FloatArray:
    """Return transforms (..., 4, 4)."""
    T = np.zeros((*quat_xyzw.shape[:-1], 4, 4))
    T[..., :3, :3] = rotation_from_quat_xyzw(quat_xyzw)
    T[..., :3, 3] = translation_m
    T[..., 3, 3] = 1.0
    return T
