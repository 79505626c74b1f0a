"""Poses of all keyframes in one version of the map, and poses of images relative to keyframes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, CameraModel, FloatArray, IntArray


class KeyframePoses(NamedTuple):
    """Snapshot of the poses of all keyframes, sorted by ascending uid.

    Poses of the main map are in the map frame. Every other map has its own frame.
    """

    # Version of the map. Each change from a mapper in another process increases it; with a mapper
    # in this process it stays the same.
    version: int
    uids: IntArray  # (N,)
    map_ids: IntArray  # (N,)
    main_map: int  # id of the map with most keyframes; the lowest id if several have as many
    T_map_camera: FloatArray  # (N, 4, 4)

    @property
    def is_main(self) -> BoolArray:
        return np.equal(self.map_ids, self.main_map)

    def rows_of(self, uids: IntArray) -> IntArray:
        return np.searchsorted(self.uids, uids)

    def row_of(self, uid: int) -> int | None:
        row = int(np.searchsorted(self.uids, uid))
        return row if row < len(self.uids) and self.uids[row] == uid else None

    def substitute(self, removed_uid: int, after: KeyframePoses) -> tuple[int, FloatArray] | None:
        """Return the keyframe to which the data of a removed keyframe is attached from now on.

        It is the preceding keyframe of the same map that `after` still has, or else the first.
        Return its uid and T_substitute_removed (4, 4), or None if that map has no keyframe left.
        """
        removed = int(self.rows_of(np.array([removed_uid]))[0])
        same = self.map_ids == self.map_ids[removed]
        rows = np.flatnonzero(same & np.isin(self.uids, after.uids))
        if len(rows) == 0:
            return None
        near = int(rows[max(int(np.searchsorted(rows, removed)) - 1, 0)])
        T_near_old = se3.inverse(self.T_map_camera[near]) @ self.T_map_camera[removed]
        return int(self.uids[near]), T_near_old


class TrackedImage(NamedTuple):
    """The pose of an image in one version of the map, measured and not predicted.

    Data is stored relative to the keyframe, so that later corrections of the map move it.
    """

    stamp_ns: int
    T_map_camera: FloatArray  # (4, 4); in the map frame if the image is in the main map
    keyframe_uid: int  # uid of the reference keyframe, which is in the map
    is_in_main_map: bool
    is_growing: bool  # whether the map is extended; False in localization


NO_KEYFRAMES = KeyframePoses(
    0, np.empty(0, np.int64), np.empty(0, np.int64), 0, np.empty((0, 4, 4))
)


class LoadedKeyframes(NamedTuple):
    """The keyframes of the map file that a session has loaded last."""

    number: int = 0  # number of maps that the session has loaded so far
    source: str = ''  # path of the map file, or the session of a node that has crashed
    saved_uids: IntArray = np.empty(0, np.int64)  # (K,) uids in that file, ascending
    loaded_uids: IntArray = np.empty(0, np.int64)  # (K,) their uids in this session


class SessionKeyframes(NamedTuple):
    """The keyframes of a session of the SLAM node, its camera and its frames."""

    session: str  # name of the session, which ends when the map is discarded
    camera: CameraModel | None  # camera of the tracked images; None: not known yet
    is_level: bool  # whether the z axis of the map frame points up
    keyframes: KeyframePoses
    loaded: LoadedKeyframes = LoadedKeyframes()
    T_camera_base: FloatArray | None = None  # (4, 4); None: no base frame is configured
