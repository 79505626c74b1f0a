"""The tracked motion of the camera, with which an IMU is compared."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import NS_PER_S, FloatArray, IntArray

_KEPT_NS = 30 * NS_PER_S  # chosen: the tracked rotation drifts by about 1 degree in this time


class TrackedPoses(NamedTuple):
    """Poses of K images that were tracked without interruption."""

    stamps_ns: IntArray  # (K,) increasing
    T_chain_camera: FloatArray  # (K, 4, 4) relative to an unknown frame


class TrackedMotion:
    """The tracked motion of the last 30 s, which interruptions divide into chains."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._T_chain_camera: list[FloatArray] = []
        self._is_first: list[bool] = []  # whether a chain begins at the image
        self.chain_ns = 0  # stamp of the image at which the last chain begins

    def add(self, first_ns: int, second_ns: int, T_first_second: FloatArray) -> None:
        """Add the motion (4, 4) between two images.

        A chain begins at the first image if that is not the last image so far. If the stamps have
        gone back, all earlier motion is dropped.
        """
        if self._stamps_ns and second_ns <= self._stamps_ns[-1]:
            self._stamps_ns, self._T_chain_camera, self._is_first = [], [], []
        if not self._stamps_ns or first_ns != self._stamps_ns[-1]:
            self._append(first_ns, np.eye(4), is_first=True)
            self.chain_ns = first_ns
        T_chain_camera = se3.orthonormalized(self._T_chain_camera[-1] @ T_first_second)
        self._append(second_ns, T_chain_camera, is_first=False)
        num_old = int(np.searchsorted(self._stamps_ns, second_ns - _KEPT_NS))
        del self._stamps_ns[:num_old], self._T_chain_camera[:num_old], self._is_first[:num_old]

    @property
    def newest_ns(self) -> int | None:
        """Return the stamp of the last image; None if there is none."""
        return self._stamps_ns[-1] if self._stamps_ns else None

    def chain(self, from_ns: int | None = None) -> TrackedPoses:
        """Return the poses of the last chain from a stamp on; None: all of them."""
        from_ns = self.chain_ns if from_ns is None else max(from_ns, self.chain_ns)
        first = int(np.searchsorted(self._stamps_ns, from_ns))
        poses = np.array(self._T_chain_camera[first:]).reshape(-1, 4, 4)
        return TrackedPoses(np.array(self._stamps_ns[first:], np.int64), poses)

    def steps(self, from_ns: int, longest_ns: int) -> tuple[IntArray, IntArray, FloatArray]:
        """Return starts (M,), ends (M,) and rotations (M, 3, 3) between successive images.

        Args:
            from_ns: Stamp from which on steps are returned.
            longest_ns: Steps over more time are left out.
        """
        first = int(np.searchsorted(self._stamps_ns, from_ns))
        stamps_ns = np.array(self._stamps_ns[first:], np.int64)
        R = np.array(self._T_chain_camera[first:]).reshape(-1, 4, 4)[:, :3, :3]
        is_used = ~np.array(self._is_first[first + 1 :], np.bool_)
        is_used &= np.diff(stamps_ns) <= longest_ns
        R_step = R[:-1].swapaxes(1, 2) @ R[1:]
        return stamps_ns[:-1][is_used], stamps_ns[1:][is_used], R_step[is_used]

    def _append(self, stamp_ns: int, T_chain_camera: FloatArray, *, is_first: bool) -> None:
        self._stamps_ns.append(stamp_ns)
        self._T_chain_camera.append(T_chain_camera)
        self._is_first.append(is_first)
