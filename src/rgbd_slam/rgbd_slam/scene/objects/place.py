"""The place of an object: a level frame that moves with a keyframe."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.model.keyframe_poses import KeyframePoses


class Anchor(NamedTuple):
    """The keyframe that new objects of an image move with, and the pose of the image."""

    uid: int
    map_id: int
    T_map_keyframe: FloatArray  # (4, 4)
    T_map_camera: FloatArray  # (4, 4)


class Place:
    """A frame with the axes of the map frame at the time when it was made.

    Args:
        T_map_object: (4, 4) present pose of the frame.
        T_anchor_object: (4, 4) pose of the frame relative to its keyframe.
        uid: Uid of this keyframe.
        map_id: Map of this keyframe.
    """

    def __init__(
        self, T_map_object: FloatArray, T_anchor_object: FloatArray, uid: int, map_id: int
    ) -> None:
        self.T_map_object = T_map_object
        self.T_anchor_object = T_anchor_object
        self.uid, self.map_id = uid, map_id

    @classmethod
    def at(cls, position_map_m: FloatArray, anchor: Anchor) -> Place:
        """Return the place with its origin at a point (3,)."""
        T = np.eye(4)
        T[:3, 3] = position_map_m
        return cls(T, se3.inverse(anchor.T_map_keyframe) @ T, anchor.uid, anchor.map_id)

    def follow(self, before: KeyframePoses, after: KeyframePoses) -> bool:
        """Move with the keyframe, or with a substitute if it was removed.

        Args:
            before: The keyframe poses until now.
            after: The present ones.

        Returns:
            False if no keyframe of the map remains.
        """
        row = after.row_of(self.uid)
        if row is None:
            near = None if before.row_of(self.uid) is None else before.substitute(self.uid, after)
            if near is None:
                return False
            self.uid, T_near_old = near
            self.T_anchor_object = T_near_old @ self.T_anchor_object
            row = after.row_of(self.uid)
        assert row is not None
        self.T_map_object = after.T_map_camera[row] @ self.T_anchor_object
        self.map_id = int(after.map_ids[row])
        return True
