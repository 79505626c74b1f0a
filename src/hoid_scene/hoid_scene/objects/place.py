"""The frame of an object of the map, which moves with a keyframe."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.values import FloatArray


class Anchor(NamedTuple):
    """The keyframe with which the new objects of an image move, and the pose of the image."""

    uid: int  # of the keyframe
    map_id: int  # of the keyframe
    T_map_keyframe: FloatArray  # (4, 4) present pose of the keyframe
    T_map_camera: FloatArray  # (4, 4) present pose of the image


class Place:
    """An object frame, which moves with a keyframe.

    It had the axes of the map frame when it was made.

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
        self._T_object_map: FloatArray | None = None  # the inverse, once it is needed
        self.T_anchor_object = T_anchor_object
        self.uid, self.map_id = uid, map_id

    @classmethod
    def at(cls, position_map_m: FloatArray, anchor: Anchor) -> Place:
        """Return a place with its origin at a point (3,) of the map frame, and the map's axes."""
        T = np.eye(4)
        T[:3, 3] = position_map_m
        return cls(T, se3.inverse(anchor.T_map_keyframe) @ T, anchor.uid, anchor.map_id)

    @property
    def T_object_map(self) -> FloatArray:  # noqa: N802 - a transform's name
        """Return the transform (4, 4) from the map frame to the object frame."""
        if self._T_object_map is None:
            self._T_object_map = se3.inverse(self.T_map_object)
        return self._T_object_map

    def follow(self, before: KeyframePoses, after: KeyframePoses) -> bool:
        """Move the frame with its keyframe, or with a substitute if that was removed.

        Args:
            before: The keyframe poses until now.
            after: The present ones.

        Returns:
            Whether the frame has a keyframe; False if no keyframe of its map remains, or if the
            keyframe is not in `before` either.
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
        T_map_object = after.T_map_camera[row] @ self.T_anchor_object
        if not np.array_equal(T_map_object, self.T_map_object):
            self.T_map_object, self._T_object_map = T_map_object, None
        self.map_id = int(after.map_ids[row])
        return True
