"""Frames of submaps and objects, which move with keyframes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.values import FloatArray

_SAME_M = 1e-5  # chosen: a frame stays where it is if its pose differs by less


class Anchor(NamedTuple):
    """The keyframe with which the content of an image moves, and the pose of the image."""

    uid: int  # uid of the keyframe
    map_id: int  # map of the keyframe
    T_map_keyframe: FloatArray  # (4, 4) present pose of the keyframe
    T_map_camera: FloatArray  # (4, 4) present pose of the image


def anchor_at(keyframes: KeyframePoses, uid: int, T_keyframe_camera: FloatArray) -> Anchor | None:
    """Return the anchor of an image relative to a keyframe; None if that has been removed."""
    row = keyframes.row_of(uid)
    if row is None:
        return None
    T_map_keyframe = keyframes.T_map_camera[row]
    map_id = int(keyframes.map_ids[row])
    return Anchor(uid, map_id, T_map_keyframe, T_map_keyframe @ T_keyframe_camera)


class Place:
    """A frame that moves with a keyframe."""

    def __init__(
        self, T_map_place: FloatArray, T_anchor_place: FloatArray, uid: int, map_id: int
    ) -> None:
        self.T_map_place, self.T_place_map = T_map_place, se3.inverse(T_map_place)
        self.T_anchor_place = T_anchor_place
        self.uid, self.map_id = uid, map_id

    @classmethod
    def at(cls, position_map_m: FloatArray, anchor: Anchor) -> Place:
        """Return a place with its origin at a point (3,) of the map frame, and the map's axes."""
        T = np.eye(4)
        T[:3, 3] = position_map_m
        return cls(T, se3.inverse(anchor.T_map_keyframe) @ T, anchor.uid, anchor.map_id)

    @classmethod
    def saved(cls, T_anchor_place: FloatArray, uid: int, keyframes: KeyframePoses) -> Place | None:
        """Return a place (4, 4) relative to a keyframe; None if that has been removed."""
        anchor = anchor_at(keyframes, uid, T_anchor_place)
        if anchor is None:
            return None
        return cls(anchor.T_map_camera, T_anchor_place, uid, anchor.map_id)

    def follow(self, before: KeyframePoses, after: KeyframePoses) -> bool:
        """Move the frame with its keyframe, or with a substitute if that was removed.

        Return False if no keyframe of its map remains.
        """
        if after.row_of(self.uid) is None:
            near = None if before.row_of(self.uid) is None else before.substitute(self.uid, after)
            if near is None:
                return False
            self.uid, T_near_old = near
            self.T_anchor_place = T_near_old @ self.T_anchor_place
        anchor = anchor_at(after, self.uid, self.T_anchor_place)
        assert anchor is not None
        self.map_id = anchor.map_id
        if np.abs(anchor.T_map_camera - self.T_map_place).max() > _SAME_M:
            self.T_map_place, self.T_place_map = (
                anchor.T_map_camera,
                se3.inverse(anchor.T_map_camera),
            )
        return True
