"""The trajectory of the camera: online poses as published, and final poses by the present map."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common import se3
from hoid_common.errors import ConfigError
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.sync import RESTART_NS
from hoid_common.values import FloatArray, IntArray, Trajectory
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.keyframes import KeyframeTable
from rgbd_slam.model.map_change import Redirect
from rgbd_slam.model.tracked_frame import TrackedFrame
from rgbd_slam.records.record_store import RecordStore
from rgbd_slam.records.soa_table import DEAD

_FRAME = np.dtype(
    [
        ('stamp_ns', np.int64),
        ('reference_uid', np.int64),
        # Transforms are stored without their last row (0, 0, 0, 1): 208 bytes per frame, because a
        # session may last days.
        ('T_map_camera', np.float64, (3, 4)),
        ('T_reference_camera', np.float64, (3, 4)),
    ]
)
_REMOVED = np.dtype(
    [('uid', np.int64), ('parent_uid', np.int64), ('T_parent_camera', np.float64, (4, 4))]
)
_NO_MAP = -1  # map id of keyframes that are pending or have no known ancestor


class _MapLink(NamedTuple):
    """The measured motion from a keyframe of a map to a keyframe of the next map."""

    before_uid: int
    after_uid: int
    T_before_after: FloatArray  # (4, 4)


class TrajectoryRecorder:
    """Stores two poses of each frame: as published, and relative to its reference keyframe.

    The second pose follows corrections of the map. Methods that read old poses raise InputError if
    their file cannot be read.
    """

    def __init__(self, atlas: Atlas) -> None:
        self._keyframes, self._guard = atlas.keyframes, atlas.guard
        self._frames = RecordStore(_FRAME, 'old poses of the trajectory')
        self._removed = RecordStore(_REMOVED, 'old keyframes of the trajectory')
        self._links: list[_MapLink] = []

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def num_unwritten(self) -> int:
        """Return the number of old frames that are in memory because no file could store them."""
        return self._frames.num_unwritten

    def add(self, tracked: TrackedFrame) -> None:
        self._frames.append(
            (
                tracked.frame.stamp_ns,
                tracked.reference_uid,
                tracked.T_map_camera[:3],
                tracked.T_reference_camera[:3],
            )
        )

    def pose(self, n: int) -> FloatArray | None:
        """Return T_map_camera (4, 4) of the `n`-th frame by the current map; None if unknown.

        The pose is in the map of the reference keyframe. It is unknown while this keyframe is
        pending, or if one or two thousand keyframes were removed after it.
        """
        frame = self._frames[n]
        map_ids, poses = self._references(frame['reference_uid'])
        if map_ids[0] == _NO_MAP:
            return None
        return np.asarray(poses[0] @ _whole(frame['T_reference_camera'][None])[0])

    def revise(self, n: int, T_map_camera: FloatArray) -> None:
        """Replace the final pose of frame `n` unless it is unknown; the online pose is kept."""
        frame = self._frames[n]
        map_ids, poses = self._references(frame['reference_uid'])
        if map_ids[0] != _NO_MAP:
            frame['T_reference_camera'] = (se3.inverse(poses[0]) @ T_map_camera)[:3]
            self._frames[n] = frame

    def become_keyframe(self, uid: int) -> None:
        """Make the last frame's final pose that of a new keyframe, which may still be pending."""
        frame = self._frames[len(self) - 1]
        frame['reference_uid'], frame['T_reference_camera'] = uid, np.eye(4)[:3]
        self._frames[len(self) - 1] = frame

    def link(self, before: TrackedFrame, after: TrackedFrame, T_before_after: FloatArray) -> None:
        """Store the motion (4, 4) from the last frame of a map to the first one of the next."""
        T = before.T_reference_camera @ T_before_after @ se3.inverse(after.T_reference_camera)
        self._links.append(_MapLink(before.reference_uid, after.reference_uid, T))

    def end_bridge(
        self, num_bridged: int, T_map_predicted: FloatArray, found: TrackedFrame
    ) -> None:
        """Correct the final poses of bridged frames by the first pose tracked after them.

        The difference between the tracked and the predicted pose (4, 4) of the frame `found` is
        spread over the time since the last tracked frame. Online poses are kept. Nothing is
        corrected if the camera was found in another map.
        """
        first = len(self) - num_bridged
        if not 0 < first < len(self):
            return
        frames = [self._frames[n] for n in range(first - 1, len(self))]
        map_ids, references = self._references(frames[-1]['reference_uid'], found.reference_uid)
        if map_ids[0] == _NO_MAP or map_ids[0] != map_ids[1]:
            return
        T_reference_map = se3.inverse(references[0])
        stamps_ns = np.array([frame['stamp_ns'] for frame in frames])
        poses = _whole(np.stack([frame['T_reference_camera'] for frame in frames[1:]]))
        share = (stamps_ns[1:] - stamps_ns[0]) / (found.frame.stamp_ns - stamps_ns[0])
        predicted, true = T_reference_map @ T_map_predicted, T_reference_map @ found.T_map_camera
        poses = _moved(poses, share, predicted, true)
        for n, frame, pose in zip(range(first, len(self)), frames[1:], poses, strict=True):
            frame['T_reference_camera'] = pose[:3]
            self._frames[n] = frame

    def redirect(self, redirects: Iterable[Redirect]) -> None:
        """Replace removed keyframes by their parents in the poses that are relative to them."""
        for redirect in redirects:
            self._removed.append(redirect)

    def online(self) -> Trajectory:
        return Trajectory.joined(self.parts('online'))

    def final(self) -> Trajectory:
        """Return the poses of all frames by the current keyframe poses of the main map.

        Frames are left out if they are in another map without a link to the main one, or if
        neither their reference keyframe nor an ancestor is in the map.
        """
        return Trajectory.joined(self.parts('final'))

    def parts(self, kind: str) -> Iterator[Trajectory]:
        """Return the trajectory of a kind (`final`, `online` or `keyframes`) in parts.

        Any thread may iterate over the parts while frames are added. ConfigError for another kind.
        """
        if kind == 'final':
            return self._final()
        if kind == 'online':
            parts = self._frames.blocks(len(self))
            return (self._valid(part['stamp_ns'], _whole(part['T_map_camera'])) for part in parts)
        if kind == 'keyframes':
            return iter([self.keyframes()])
        raise ConfigError(f'no trajectory "{kind}"; use one of final, online, keyframes')

    def keyframes(self) -> Trajectory:
        """Return the main map's keyframe poses of this session, in order of insertion."""
        keyframes = self._keyframes
        rows = keyframes.indices_by_uid()
        rows = rows[(keyframes.map_id[rows] == main_map(keyframes)) & ~keyframes.is_loaded[rows]]
        return Trajectory(keyframes.stamp_ns[rows], keyframes.T_map_camera[rows])

    def _final(self) -> Iterator[Trajectory]:
        snapshot, num_removed = _PoseSnapshot(self._keyframes), len(self._removed)
        parts, links = self._frames.blocks(len(self)), tuple(self._links)

        def final_parts() -> Iterator[Trajectory]:
            removed = _by_uid(self._removed.blocks(num_removed))
            snapshot.connect(links, removed)
            for part in parts:
                uids, which = np.unique(part['reference_uid'], return_inverse=True)
                rows, T_map_reference = snapshot.of(uids, removed)
                poses = T_map_reference[which] @ _whole(part['T_reference_camera'])
                known = snapshot.is_main[rows[which]]
                yield self._valid(part['stamp_ns'][known], poses[known])

        return final_parts()

    def _valid(self, stamps_ns: IntArray, poses: FloatArray) -> Trajectory:
        is_valid = self._guard.are_valid(poses, 'the trajectory')
        return Trajectory(stamps_ns[is_valid], poses[is_valid])

    def _references(self, *uids: int) -> tuple[IntArray, FloatArray]:
        """Return map id (or _NO_MAP) and T_map_keyframe (4, 4) of each of K keyframes."""
        snapshot, removed = _PoseSnapshot(self._keyframes), _by_uid([self._removed.newest()])
        rows, poses = snapshot.of(np.array(uids), removed)
        return snapshot.map_id[rows], poses


class _PoseSnapshot:
    """Snapshot of all keyframe poses. Row 0 is a sentinel for unknown keyframes, in no map."""

    def __init__(self, keyframes: KeyframeTable) -> None:
        rows = keyframes.indices_by_uid()
        self._uids = np.append(DEAD, keyframes.uid[rows])
        self._T_map_camera = np.concatenate([np.eye(4)[None], keyframes.T_map_camera[rows]])
        self.map_id, self._main = np.append(_NO_MAP, keyframes.map_id[rows]), main_map(keyframes)
        self.is_main = self.map_id == self._main

    def connect(self, links: Sequence[_MapLink], removed: NDArray[np.void]) -> None:
        """Convert the poses of all maps that are linked with the main one to its frame."""
        uids = np.array([link[:2] for link in links], np.int64).reshape(-1, 2)
        rows, poses = self.of(uids.ravel(), removed)
        ends = self.map_id[rows].reshape(-1, 2).tolist()
        T_main = {self._main: np.eye(4)}  # by map: T_main_map, for connected maps
        for _ in links:  # each round connects another map, or all are connected
            for (before, after), (T_before, T_after), link in zip(
                ends, poses.reshape(-1, 2, 4, 4), links, strict=True
            ):
                # T_before_after between the maps.
                T = T_before @ link.T_before_after @ se3.inverse(T_after)
                if before in T_main and after not in T_main:
                    T_main[after] = T_main[before] @ T
                elif after in T_main and before not in T_main:
                    T_main[before] = T_main[after] @ se3.inverse(T)
        for map_id in T_main.keys() - {self._main, _NO_MAP}:
            is_in_map = self.map_id == map_id
            self._T_map_camera[is_in_map] = T_main[map_id] @ self._T_map_camera[is_in_map]
            self.is_main |= is_in_map

    def of(self, uids: IntArray, removed: NDArray[np.void]) -> tuple[IntArray, FloatArray]:
        """Return rows (K,) of keyframes, or of ancestors of removed ones, and the K poses."""
        T_parent_camera = np.tile(np.eye(4), (len(uids), 1, 1))
        while (
            n := _find(removed['uid'], uids)
        ).any():  # from child to parent in the spanning tree
            T_parent_camera = np.where(
                n[:, None, None] > 0,
                removed['T_parent_camera'][n] @ T_parent_camera,
                T_parent_camera,
            )
            uids = np.where(n > 0, removed['parent_uid'][n], uids)
        rows = _find(self._uids, uids)
        return rows, self._T_map_camera[rows] @ T_parent_camera


def _moved(
    poses: FloatArray, share: FloatArray, predicted: FloatArray, true: FloatArray
) -> FloatArray:
    """Return poses (N, 4, 4) moved by ratios (N,) of the motion between two poses (4, 4)."""
    turn = np.zeros((len(share), 6))
    turn[:, :3] = share[:, None] * se3.log(se3.inverse(predicted) @ true)[:3]
    moved = poses @ se3.exp(turn)
    moved[:, :3, 3] += share[:, None] * (true - predicted)[:3, 3]
    return np.asarray(moved)


def _by_uid(parts: Iterable[NDArray[np.void]]) -> NDArray[np.void]:
    """Return the removed keyframes sorted by uid, after a sentinel with uid DEAD."""
    none = np.zeros(1, _REMOVED)
    none['uid'] = DEAD
    removed = np.concatenate([none, *parts])
    return removed[np.argsort(removed['uid'], kind='stable')]


def _find(ascending: IntArray, uids: IntArray) -> IntArray:
    """Return the last index of each uid (K,) in the ascending uids; 0: it is not there."""
    n = np.searchsorted(ascending, uids, side='right') - 1
    return np.where(ascending[n] == uids, n, 0)


def current_pass(poses: Trajectory) -> Trajectory:
    """Return the poses since the stamps last went back, with increasing stamps."""
    restarts = np.flatnonzero(np.diff(poses.stamps_ns) <= -RESTART_NS)
    first = int(restarts[-1]) + 1 if len(restarts) else 0
    stamps_ns, rows = np.unique(poses.stamps_ns[first:], return_index=True)
    return Trajectory(stamps_ns, poses.T_world_camera[first:][rows])


def main_map(keyframes: KeyframeTable) -> int:
    """Return the id of the map with most keyframes (the lowest of several); 0 if there is none."""
    ids = keyframes.map_id[keyframes.indices()]
    return int(np.bincount(ids).argmax()) if len(ids) else 0


def keyframe_poses(atlas: Atlas) -> KeyframePoses:
    keyframes = atlas.keyframes
    rows = keyframes.indices_by_uid()
    return KeyframePoses(
        atlas.version,
        keyframes.uid[rows],
        keyframes.map_id[rows],
        main_map(keyframes),
        keyframes.T_map_camera[rows],
    )


def _whole(upper: FloatArray) -> FloatArray:
    """Return the poses (N, 4, 4) with these first three rows (N, 3, 4)."""
    poses = np.zeros((len(upper), 4, 4))
    poses[:, :3], poses[:, 3, 3] = upper, 1.0
    return poses
