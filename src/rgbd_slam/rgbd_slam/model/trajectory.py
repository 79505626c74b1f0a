"""Where the camera was: poses as published at the time, and as the map says now."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.values import FloatArray, IntArray, Trajectory
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.model.keyframes import KeyframeTable
from rgbd_slam.model.map_change import Redirect
from rgbd_slam.model.tracked_frame import TrackedFrame

_BLOCK = 1024  # frames
_FRAME = np.dtype(
    [
        ('stamp_ns', np.int64),
        ('reference_uid', np.int64),
        # Without their last rows (0, 0, 0, 1): 208 bytes a frame, as a session may last for days.
        ('T_map_camera', np.float64, (3, 4)),
        ('T_reference_camera', np.float64, (3, 4)),
    ]
)
FRAME_BYTES = _FRAME.itemsize


class TrajectoryRecorder:
    """Stores frames relative to their reference keyframes: later corrections reach them.

    Args:
        keyframes: Of the map.
    """

    def __init__(self, keyframes: KeyframeTable) -> None:
        self._keyframes = keyframes
        self._blocks = [np.empty(0, _FRAME)]  # all but the first of _BLOCK frames
        self._count = 0
        self._removed: dict[int, Redirect] = {}  # keyframes, and what took their place

    def __len__(self) -> int:
        return self._count

    def add(self, tracked: TrackedFrame) -> None:
        """Record a frame; its poses are copied."""
        n = self._count % _BLOCK
        if n == 0:
            self._blocks.append(np.empty(_BLOCK, _FRAME))
        self._blocks[-1][n] = (
            tracked.frame.stamp_ns,
            tracked.reference_uid,
            tracked.T_map_camera[:3],
            tracked.T_reference_camera[:3],
        )
        self._count += 1

    def pose(self, n: int) -> FloatArray | None:
        """Return T_map_camera (4, 4) of frame `n` as the map says now; None once that is gone."""
        frame = self._frame(n)
        (row,), (T_map_reference,) = self._placed(frame['reference_uid'][None])
        return None if row < 0 else T_map_reference @ _whole(frame['T_reference_camera'][None])[0]

    def revise(self, n: int, T_map_camera: FloatArray) -> None:
        """Say anew where frame `n` was; what was known at the time stays as it was said."""
        frame = self._frame(n)
        _, (T_map_reference,) = self._placed(frame['reference_uid'][None])
        frame['T_reference_camera'] = (se3.inverse(T_map_reference) @ T_map_camera)[:3]

    def redirect(self, redirects: Iterable[Redirect]) -> None:
        """Hang frames of removed keyframes on those that took their place."""
        self._removed.update((redirect.uid, redirect) for redirect in redirects)

    def online(self) -> Trajectory:
        """Return the poses as they were known when each frame was tracked."""
        frames = self._frames()
        return Trajectory(frames['stamp_ns'].copy(), _whole(frames['T_map_camera']))

    def final(self) -> Trajectory:
        """Return the poses that follow from where the keyframes of the main map are now.

        Frames of other maps are left out: nothing says where those maps lie.
        """
        frames, keyframes = self._frames(), self._keyframes
        uids, which = np.unique(frames['reference_uid'], return_inverse=True)
        rows, T_map_reference = self._placed(uids)
        poses = T_map_reference[which] @ _whole(frames['T_reference_camera'])
        known = np.isin(which, np.flatnonzero(rows >= 0))
        known &= keyframes.map_id[rows[which]] == main_map(keyframes)
        return Trajectory(frames['stamp_ns'][known], poses[known])

    def keyframes(self) -> Trajectory:
        """Return the poses of this session's keyframes in the main map, in order of time."""
        keyframes = self._keyframes
        rows = keyframes.indices()
        rows = rows[(keyframes.map_id[rows] == main_map(keyframes)) & ~keyframes.is_loaded[rows]]
        rows = rows[np.argsort(keyframes.stamp_ns[rows], kind='stable')]
        return Trajectory(keyframes.stamp_ns[rows].copy(), keyframes.T_map_camera[rows].copy())

    def _frame(self, n: int) -> NDArray[np.void]:
        """Return the record of a frame, () and to be written to."""
        return self._blocks[1 + n // _BLOCK][n % _BLOCK, ...]

    def _frames(self) -> NDArray[np.void]:
        return np.concatenate(self._blocks)[: self._count]

    def _placed(self, uids: IntArray) -> tuple[IntArray, FloatArray]:
        """Return the rows (K,) that keyframes hang on, removed ones too, and where they are.

        The row is -1 for those that left with all of their map.
        """
        keyframes = self._keyframes
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


def keyframe_poses(atlas: Atlas) -> KeyframePoses:
    """Return where the keyframes of all maps are."""
    keyframes = atlas.keyframes
    rows = keyframes.indices()
    rows = rows[np.argsort(keyframes.uid[rows])]
    return KeyframePoses(
        atlas.version, keyframes.uid[rows], keyframes.map_id[rows], main_map(keyframes),
        keyframes.T_map_camera[rows],
    )  # fmt: skip


def _whole(upper: FloatArray) -> FloatArray:
    """Return poses (N, 4, 4) of their first three rows (N, 3, 4)."""
    poses = np.zeros((len(upper), 4, 4))
    poses[:, :3], poses[:, 3, 3] = upper, 1.0
    return poses
