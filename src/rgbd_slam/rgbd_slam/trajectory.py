"""Where the camera was: poses as published at the time, and as the map says now."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from hoid_common.values import FloatArray, Trajectory
from rgbd_slam.keyframes import KeyframeTable
from rgbd_slam.map import Redirect


class TrajectoryRecorder:
    """Stores frames relative to their reference keyframes: later corrections reach them."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._online: list[FloatArray] = []
        self._reference_uid: list[int] = []
        self._T_reference_camera: list[FloatArray] = []

    def __len__(self) -> int:
        return len(self._stamps_ns)

    def add(
        self,
        stamp_ns: int,
        T_map_camera: FloatArray,
        reference_uid: int,
        T_reference_camera: FloatArray,
    ) -> None:
        """Record a tracked frame."""
        self._stamps_ns.append(stamp_ns)
        self._online.append(T_map_camera)
        self._reference_uid.append(reference_uid)
        self._T_reference_camera.append(T_reference_camera)

    def redirect(self, redirects: Iterable[Redirect]) -> None:
        """Hang frames of removed keyframes on those that took their place."""
        for redirect in redirects:
            for n, uid in enumerate(self._reference_uid):
                if uid == redirect.uid:
                    self._reference_uid[n] = redirect.parent_uid
                    self._T_reference_camera[n] = (
                        redirect.T_parent_camera @ self._T_reference_camera[n]
                    )

    def online(self) -> Trajectory:
        """Return the poses as they were known when each frame was tracked."""
        return Trajectory(np.array(self._stamps_ns, np.int64), _stacked(self._online))

    def final(self, keyframes: KeyframeTable) -> Trajectory:
        """Return the poses that follow from where the keyframes are now."""
        rows = keyframes.indices()
        order = np.argsort(keyframes.uid[rows])
        uids = keyframes.uid[rows][order]
        at = rows[order[np.searchsorted(uids, np.array(self._reference_uid, np.int64))]]
        poses = keyframes.T_map_camera[at] @ _stacked(self._T_reference_camera)
        return Trajectory(np.array(self._stamps_ns, np.int64), poses)


def keyframe_trajectory(keyframes: KeyframeTable) -> Trajectory:
    """Return the keyframes' poses in order of time."""
    rows = keyframes.indices()
    rows = rows[np.argsort(keyframes.stamp_ns[rows], kind='stable')]
    return Trajectory(keyframes.stamp_ns[rows].copy(), keyframes.T_map_camera[rows].copy())


def _stacked(poses: list[FloatArray]) -> FloatArray:
    return np.array(poses).reshape(-1, 4, 4)
