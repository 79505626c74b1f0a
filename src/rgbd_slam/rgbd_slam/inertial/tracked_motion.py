"""The tracked motion of the camera, by which an IMU is calibrated."""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import NS_PER_S, FloatArray, IntArray

_KEPT_NS = 30 * NS_PER_S  # chosen: in this time, the tracked rotation drifts by about 1 degree


class TrackedPoses(NamedTuple):
    """Poses of K images that were tracked without interruption."""

    stamps_ns: IntArray  # (K,) increasing
    T_chain_camera: FloatArray  # (K, 4, 4) relative to the frame of their chain


class _Image(NamedTuple):
    stamp_ns: int
    T_chain_camera: FloatArray  # (4, 4)
    is_first: bool  # whether a chain of uninterrupted tracking begins at the image


class TrackedMotion:
    """The tracked poses of the last 30 s; each interruption begins a new chain."""

    def __init__(self) -> None:
        self._images: list[_Image] = []
        self.chain_ns = 0  # stamp of the image at which the last chain begins

    def add(self, first_ns: int, second_ns: int, T_first_second: FloatArray) -> None:
        """Add the motion (4, 4) between two images; a gap before them begins a new chain."""
        newest_ns = self.newest_ns
        if newest_ns is not None and second_ns <= newest_ns:
            self._images = []
        if newest_ns != first_ns or not self._images:
            self._images.append(_Image(first_ns, np.eye(4), is_first=True))
            self.chain_ns = first_ns
        T_chain_camera = se3.orthonormalized(self._images[-1].T_chain_camera @ T_first_second)
        self._images.append(_Image(second_ns, T_chain_camera, is_first=False))
        del self._images[: self._index(second_ns - _KEPT_NS)]

    @property
    def newest_ns(self) -> int | None:
        return self._images[-1].stamp_ns if self._images else None

    def chain(self, from_ns: int | None = None) -> TrackedPoses:
        """Return the poses of the newest chain from a stamp on; None: all of them."""
        from_ns = self.chain_ns if from_ns is None else max(from_ns, self.chain_ns)
        return self._poses(self._index(from_ns))

    def steps(self, from_ns: int, longest_ns: int) -> tuple[IntArray, IntArray, FloatArray]:
        """Return both stamps (M,), (M,) and the rotation (M, 3, 3) of steps up to `longest_ns`."""
        first = self._index(from_ns)
        stamps_ns, T = self._poses(first)
        R = T[:, :3, :3]
        is_used = ~np.array([image.is_first for image in self._images[first + 1 :]], np.bool_)
        is_used &= np.diff(stamps_ns) <= longest_ns
        R_step = R[:-1].swapaxes(1, 2) @ R[1:]
        return stamps_ns[:-1][is_used], stamps_ns[1:][is_used], R_step[is_used]

    def _index(self, from_ns: int) -> int:
        return bisect_left(self._images, from_ns, key=lambda image: image.stamp_ns)

    def _poses(self, first: int) -> TrackedPoses:
        stamps_ns = np.array([image.stamp_ns for image in self._images[first:]], np.int64)
        poses = np.array([image.T_chain_camera for image in self._images[first:]])
        return TrackedPoses(stamps_ns, poses.reshape(-1, 4, 4))
