"""A recognized place: the measured pose of one keyframe relative to another, with its evidence."""

from __future__ import annotations

from typing import NamedTuple

from hoid_common.values import FloatArray


class LoopEdge(NamedTuple):
    """A loop or join that was found, whether or not the map uses it."""

    first_uid: int  # the keyframe that was recognized
    second_uid: int  # the keyframe in which it was recognized
    T_first_second: FloatArray  # (4, 4)
    num_inliers: int  # matched points that agree with it
    kind: str  # how it was found, such as "loop" or "join"
    is_used: bool  # False: it was left out, because it contradicts the rest of the map
