"""The true changes between two visits of a room, and which of them the second one shows."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from hoid_benchmarks.rooms.object_truth import TrueObject
from hoid_common import se3
from hoid_common.values import FloatArray
from hoid_synth.render.tracer import Tracer
from hoid_synth.room_truth import RoomTruth

_MOVED_M = 0.15  # an object nearer to its old place was not moved; as for carried objects
_EVERY = 3  # images; of these every third is compared
_MAX_POINTS = 300  # of the surface that the first visit showed, chosen
_RANGE_M = 5.0  # as for the objects that are expected to be found
# Chosen: a place is shown empty if the images look through half of the surface for a second.
_BEHIND_M, _SHARE, _SHOWN_S = 0.05, 0.5, 1.0


class ChangeKind(Enum):
    """What happened to an object between two visits."""

    MOVED = 'moved'
    GONE = 'gone'
    NEW = 'new'


class TrueChange(NamedTuple):
    """A change; an object that was moved is at `before` in the first visit, at `after` later."""

    kind: ChangeKind
    class_name: str
    before: TrueObject | None  # None: it is new
    after: TrueObject | None  # None: it is gone
    is_expected: bool  # whether the visits showed its places long enough to find the change


class TrueVisits(NamedTuple):
    """The true objects of two visits by instance, and the changes between them."""

    first: dict[int, TrueObject]
    second: dict[int, TrueObject]
    changes: tuple[TrueChange, ...]
    unchanged: frozenset[int]  # instances of the objects that stayed at their places


def true_visits(
    first: Sequence[TrueObject],
    second: Sequence[TrueObject],
    truth: RoomTruth,
    num_known: int,
) -> TrueVisits:
    """Return the objects of both visits, in the map frame of the first one, and the changes.

    An object that is in the room at both visits, but was not visible in one of them, is neither
    changed nor unchanged.

    Args:
        first: The objects at the end of the first visit.
        second: The objects at the end of the second visit.
        truth: The room at the second visit, with the map frame of the first one.
        num_known: Number of instances of the room at the first visit; added ones have larger
            numbers.
    """
    before, after = ({item.instance: item for item in items} for items in (first, second))
    views = _Views(truth)
    gone = [old for k, old in before.items() if k not in after and k not in views.instances]
    both = [(old, after[k]) for k, old in before.items() if k in after]
    changes = [views.change(old, None) for old in gone]
    changes += [views.change(old, new) for old, new in both if _is_moved(old, new)]
    changes += [
        TrueChange(ChangeKind.NEW, item.class_name, None, item, item.is_expected)
        for k, item in after.items()
        if k >= num_known
    ]
    unchanged = frozenset(old.instance for old, new in both if not _is_moved(old, new))
    return TrueVisits(before, after, tuple(changes), unchanged)


def _is_moved(old: TrueObject, new: TrueObject) -> bool:
    return bool(np.linalg.norm(new.whole.center_m - old.whole.center_m) >= _MOVED_M)


class _Views:
    """The images of a visit.

    Attributes:
        instances: The instances that are in the room.
    """

    def __init__(self, truth: RoomTruth) -> None:
        self._truth = truth
        stage = truth.stage
        self.instances = set(np.unique(stage.static_mesh.instance).tolist())
        self.instances |= {placed.instance for placed in stage.world.props}
        self._static = Tracer(stage.static_mesh.vertices_m, stage.static_mesh.faces)

    def change(self, old: TrueObject, new: TrueObject | None) -> TrueChange:
        """Return the change of an object that was moved, or taken if `new` is None."""
        kind = ChangeKind.GONE if new is None else ChangeKind.MOVED
        is_found = old.is_expected and (new is None or new.is_expected)
        is_expected = is_found and self.show_empty(old.seen_m)
        return TrueChange(kind, old.class_name, old, new, is_expected)

    def show_empty(self, seen_map_m: FloatArray) -> bool:
        """Return whether they look through most of a surface (N, 3) for long enough."""
        config = self._truth.stage.config
        step = max(1, len(seen_map_m) // _MAX_POINTS)
        points = se3.transform(self._truth.T_world_map, seen_map_m[::step])
        count = sum(self._look_through(points, i) for i in range(0, config.frames, _EVERY))
        return count * _EVERY / config.rate_hz >= _SHOWN_S

    def _look_through(self, points_m: FloatArray, i: int) -> bool:
        """Return whether image i shows something behind most of the points (N, 3), world frame."""
        stage, camera = self._truth.stage, self._truth.stage.config.camera
        T = stage.T_world_camera[i]
        local = se3.transform(se3.inverse(T), points_m)
        ahead = (local[:, 2] > 0) & (local[:, 2] < _RANGE_M)
        uv = camera.project_px(np.where(ahead[:, None], local, [0, 0, 1.0]))
        in_view = ahead & ((uv >= 0) & (uv < (camera.width_px, camera.height_px))).all(axis=1)
        if in_view.mean() < _SHARE:
            return False
        way = (points_m[in_view] - T[:3, 3]).astype(np.float32)
        t = self._static.first_hits(T[:3, 3], way).t
        if (moving := stage.moving_mesh(i)) is not None:
            others = Tracer(moving.vertices_m, moving.faces).first_hits(T[:3, 3], way)
            t = np.minimum(t, others.t)
        is_behind = (t - 1) * np.linalg.norm(way, axis=1) > _BEHIND_M
        return bool(np.count_nonzero(is_behind) >= _SHARE * len(points_m))
