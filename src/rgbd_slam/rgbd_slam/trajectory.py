"""Where the camera was: poses as published at the time, and as the map says now."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from hoid_common.values import FloatArray, IntArray, Trajectory
from rgbd_slam.frame_poses import KeyframePoses
from rgbd_slam.keyframes import KeyframeTable
from rgbd_slam.map import Redirect, SlamMap


class TrajectoryRecorder:
    """Stores frames relative to their reference keyframes: later corrections reach them."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._online: list[FloatArray] = []
        self._reference_uid: list[int] = []
        self._T_reference_camera: list[FloatArray] = []
        self._removed: dict[int, Redirect] = {}  # keyframes, and what took their place

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
        self._removed.update((redirect.uid, redirect) for redirect in redirects)

    def online(self) -> Trajectory:
        """Return the poses as they were known when each frame was tracked."""
        return Trajectory(np.array(self._stamps_ns, np.int64), _stacked(self._online))

    def final(self, keyframes: KeyframeTable) -> Trajectory:
        """Return the poses that follow from where the keyframes of the main map are now.

        Frames of other maps are left out: nothing says where those maps lie.
        """
        uids, which = np.unique(np.array(self._reference_uid, np.int64), return_inverse=True)
        rows, T_map_reference = self._placed(keyframes, uids)
        poses = T_map_reference[which] @ _stacked(self._T_reference_camera)
        known = np.isin(which, np.flatnonzero(rows >= 0))
        known &= keyframes.map_id[rows[which]] == main_map(keyframes)
        return Trajectory(np.array(self._stamps_ns, np.int64)[known], poses[known])

    def _placed(self, keyframes: KeyframeTable, uids: IntArray) -> tuple[IntArray, FloatArray]:
        """Return the rows (K,) that keyframes hang on, removed ones too, and where they are.

        The row is -1 for those that left with all of their map.
        """
        row_of = {int(keyframes.uid[i]): i for i in keyframes.indices().tolist()}
        rows, poses = np.empty(len(uids), np.int64), np.empty((len(uids), 4, 4))
        for n, uid in enumerate(uids.tolist()):
            T_parent_camera = np.eye(4)
            while (removed := self._removed.get(uid)) is not None:
                T_parent_camera = removed.T_parent_camera @ T_parent_camera
                uid = removed.parent_uid  # noqa: PLW2901 - up the tree
            rows[n] = row_of.get(uid, -1)
            poses[n] = keyframes.T_map_camera[rows[n]] @ T_parent_camera
        return rows, poses


def main_map(keyframes: KeyframeTable) -> int:
    """Return the map with most keyframes, the older of equals.

    After a loss there may be several, each in a frame of its own until a known place joins them.
    """
    ids = keyframes.map_id[keyframes.indices()]
    return int(np.bincount(ids).argmax()) if len(ids) else 0


def keyframe_trajectory(keyframes: KeyframeTable) -> Trajectory:
    """Return the poses of this session's keyframes in the main map, in order of time."""
    rows = keyframes.indices()
    rows = rows[(keyframes.map_id[rows] == main_map(keyframes)) & ~keyframes.is_loaded[rows]]
    rows = rows[np.argsort(keyframes.stamp_ns[rows], kind='stable')]
    return Trajectory(keyframes.stamp_ns[rows].copy(), keyframes.T_map_camera[rows].copy())


def keyframe_poses(slam_map: SlamMap) -> KeyframePoses:
    """Return where the keyframes of all maps are."""
    keyframes = slam_map.keyframes
    rows = keyframes.indices()
    rows = rows[np.argsort(keyframes.uid[rows])]
    return KeyframePoses(
        slam_map.version, keyframes.uid[rows], keyframes.map_id[rows], main_map(keyframes),
        keyframes.T_map_camera[rows],
    )  # fmt: skip


def _stacked(poses: list[FloatArray]) -> FloatArray:
    return np.array(poses).reshape(-1, 4, 4)
