"""Where the camera was: poses as published at the time, and as the map says now."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.errors import ConfigError
from hoid_common.io.record_store import RecordStore
from hoid_common.values import FloatArray, IntArray, Trajectory
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.model.keyframes import KeyframeTable
from rgbd_slam.model.map_change import Redirect
from rgbd_slam.model.soa_table import DEAD
from rgbd_slam.model.tracked_frame import TrackedFrame

_FRAME = np.dtype(
    [
        ('stamp_ns', np.int64),
        ('reference_uid', np.int64),
        # Without their last rows (0, 0, 0, 1): 208 bytes a frame, as a session may last for days.
        ('T_map_camera', np.float64, (3, 4)),
        ('T_reference_camera', np.float64, (3, 4)),
    ]
)
_REMOVED = np.dtype(
    [('uid', np.int64), ('parent_uid', np.int64), ('T_parent_camera', np.float64, (4, 4))]
)
_NOWHERE = 0  # row of what hangs on nothing that is there


class TrajectoryRecorder:
    """Stores frames relative to their reference keyframes: later corrections reach them.

    Args:
        keyframes: Of the map.
    """

    def __init__(self, keyframes: KeyframeTable) -> None:
        self._keyframes = keyframes
        self._frames = RecordStore(_FRAME, 'old poses of the trajectory')
        self._removed = RecordStore(_REMOVED, 'old keyframes of the trajectory')

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def num_unwritten(self) -> int:
        """Return how many old frames are in memory because no file takes them."""
        return self._frames.num_unwritten

    def add(self, tracked: TrackedFrame) -> None:
        """Record a frame; its poses are copied."""
        self._frames.append(
            (
                tracked.frame.stamp_ns,
                tracked.reference_uid,
                tracked.T_map_camera[:3],
                tracked.T_reference_camera[:3],
            )
        )

    def pose(self, n: int) -> FloatArray | None:
        """Return T_map_camera (4, 4) of frame `n` as the map says now; None once that is gone.

        Of the keyframes removed, only the last thousand are looked at.
        """
        frame = self._frames[n]
        row, T_map_reference = self._reference(frame)
        if row == _NOWHERE:
            return None
        return np.asarray(T_map_reference @ _whole(frame['T_reference_camera'][None])[0])

    def revise(self, n: int, T_map_camera: FloatArray) -> None:
        """Say anew where frame `n` was; what was known at the time stays as it was said."""
        frame = self._frames[n]
        _, T_map_reference = self._reference(frame)
        frame['T_reference_camera'] = (se3.inverse(T_map_reference) @ T_map_camera)[:3]
        self._frames[n] = frame

    def redirect(self, redirects: Iterable[Redirect]) -> None:
        """Hang frames of removed keyframes on those that took their place."""
        for redirect in redirects:
            self._removed.append(redirect)

    def online(self) -> Trajectory:
        """Return the poses as they were known when each frame was tracked."""
        return Trajectory.joined(self.parts('online'))

    def final(self) -> Trajectory:
        """Return the poses that follow from where the keyframes of the main map are now.

        Frames of other maps are left out: nothing says where those maps lie.
        """
        return Trajectory.joined(self.parts('final'))

    def parts(self, kind: str) -> Iterator[Trajectory]:
        """Return what `final`, `online` or `keyframes` does, by that name, bit by bit.

        The parts may be taken in any thread, while recording goes on.

        Raises:
            ConfigError: Another kind.
        """
        if kind == 'final':
            return self._final()
        if kind == 'online':
            parts = self._frames.blocks(len(self))
            return (Trajectory(part['stamp_ns'], _whole(part['T_map_camera'])) for part in parts)
        if kind == 'keyframes':
            return iter([self.keyframes()])
        raise ConfigError(f'no trajectory "{kind}"; use one of final, online, keyframes')

    def keyframes(self) -> Trajectory:
        """Return the poses of this session's keyframes in the main map, in order of time."""
        keyframes = self._keyframes
        rows = keyframes.indices()
        rows = rows[(keyframes.map_id[rows] == main_map(keyframes)) & ~keyframes.is_loaded[rows]]
        rows = rows[np.argsort(keyframes.stamp_ns[rows], kind='stable')]
        return Trajectory(keyframes.stamp_ns[rows].copy(), keyframes.T_map_camera[rows].copy())

    def _final(self) -> Iterator[Trajectory]:
        places, num_removed = _Places(self._keyframes), len(self._removed)
        parts = self._frames.blocks(len(self))

        def placed() -> Iterator[Trajectory]:
            removed = _by_uid(self._removed.blocks(num_removed))
            for part in parts:
                uids, which = np.unique(part['reference_uid'], return_inverse=True)
                rows, T_map_reference = places.of(uids, removed)
                poses = T_map_reference[which] @ _whole(part['T_reference_camera'])
                known = places.is_main[rows[which]]
                yield Trajectory(part['stamp_ns'][known], poses[known])

        return placed()

    def _reference(self, frame: np.void) -> tuple[int, FloatArray]:
        """Return the row among places of what a frame hangs on, and T_map_reference (4, 4)."""
        removed = _by_uid([self._removed.newest()])
        rows, poses = _Places(self._keyframes).of(frame['reference_uid'][None], removed)
        return int(rows[0]), poses[0]


class _Places:
    """Where keyframes are at one time; first one that is nowhere, for those that are gone."""

    def __init__(self, keyframes: KeyframeTable) -> None:
        rows = keyframes.indices()
        rows = rows[np.argsort(keyframes.uid[rows])]
        self._uids = np.append(DEAD, keyframes.uid[rows])
        self._T_map_camera = np.concatenate([np.eye(4)[None], keyframes.T_map_camera[rows]])
        self.is_main = np.append(False, keyframes.map_id[rows] == main_map(keyframes))

    def of(self, uids: IntArray, removed: NDArray[np.void]) -> tuple[IntArray, FloatArray]:
        """Return the rows (K,) that keyframes hang on, and T_map_keyframe (K, 4, 4).

        Args:
            uids: (K,) of keyframes, removed ones too.
            removed: As `_by_uid` returns them.
        """
        T_parent_camera = np.tile(np.eye(4), (len(uids), 1, 1))
        while (n := _find(removed['uid'], uids)).any():  # up the tree
            T_parent_camera = np.where(
                n[:, None, None] > 0,
                removed['T_parent_camera'][n] @ T_parent_camera,
                T_parent_camera,
            )
            uids = np.where(n > 0, removed['parent_uid'][n], uids)
        rows = _find(self._uids, uids)
        return rows, self._T_map_camera[rows] @ T_parent_camera


def _by_uid(parts: Iterable[NDArray[np.void]]) -> NDArray[np.void]:
    """Return removed keyframes in order of their uids; the first of them is none."""
    none = np.zeros(1, _REMOVED)
    none['uid'] = DEAD
    removed = np.concatenate([none, *parts])
    return removed[np.argsort(removed['uid'], kind='stable')]


def _find(ascending: IntArray, uids: IntArray) -> IntArray:
    """Return where uids (K,) stand among ascending ones, the last of equals; 0 if they do not."""
    n = np.searchsorted(ascending, uids, side='right') - 1
    return np.where(ascending[n] == uids, n, 0)


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
