"""Carries: how maps and tracks follow the objects that people carry through a rendered room."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_benchmarks.rooms.object_truth import TrueObject
from hoid_benchmarks.rooms.room_run import ObjectHistory, Tracks
from hoid_common import se3
from hoid_common.values import Detections, FloatArray, ObjectState
from hoid_synth.acting.acting import ObjectTrack
from hoid_synth.render.tracer import Tracer
from hoid_synth.room.world import PlacedProp
from hoid_synth.room_truth import RoomTruth

# Chosen: a carry is evaluated if the object was shown for this long before and after it, with a
# box of at least so many pixels at VGA, and nearer than this. The time after it is that after
# which the dense map must show the object (`RoomTruth`). Both ends are seen if images also show
# through the old place for the third time before the object is gripped again.
_BEFORE_S, _AFTER_S, _EMPTY_S, _MIN_BOX_PX, _RANGE_M = 1.0, 2.0, 1.0, 400, 5.0
_EVERY = 3  # images of the 30 Hz camera for each in which the old place is looked at
_MOVED_M = 0.15  # an object that was put down nearer to its old place was not carried
# A place is filled if the dense map has points within this distance of this share of the surface
# that was seen there.
_NEAR_M, _FILLED_SHARE = 0.03, 0.5
_SAME_M = 0.35  # an object of the map farther from a true place is another object
# A person may hide the object for this long before the grip: an object that left its place in the
# map is searched among those that people took up to this long before its last sighting.
_HIDDEN_S = 1.0


class Placed(NamedTuple):
    """An object of an object map, or a track, at one time."""

    number: int
    class_name: str
    center_map_m: FloatArray  # (3,)
    state: ObjectState
    last_ns: int  # stamp of its last sighting
    moved_ns: int = 0  # stamp of its last sighting at the place before; 0: it was not moved


History = Mapping[int, Sequence[Placed]]
"""Objects or tracks by the stamp (ns) of the image."""


def placed_objects(history: ObjectHistory) -> History:
    """Return the objects of an object map after each look."""
    return {
        stamp_ns: [
            Placed(o.object_id, o.class_name, o.center_map_m, o.state, o.last_ns, o.moved_ns)
            for o in objects
        ]
        for stamp_ns, objects in history.items()
    }


def placed_tracks(tracks: Tracks) -> History:
    """Return the published tracks."""
    return {
        stamp_ns: [
            Placed(t.track_id, t.class_name, t.position_map_m, t.state, stamp_ns) for t in found
        ]
        for stamp_ns, found in tracks.items()
    }


class TrueCarry(NamedTuple):
    """An object that a person carried from one place to another, in the map frame."""

    prop: int  # index of the object in the world
    class_name: str
    first: int  # frame in which it was gripped
    end: int  # first frame at its new place, or the number of frames
    until: int  # frame in which it is gripped again, or the number of frames
    from_map_m: FloatArray  # (3,) center of the object at its old place
    to_map_m: FloatArray  # (3,) center at its new place
    is_shown: bool  # whether it was shown long enough at both places to be evaluated
    is_both_seen: bool = False  # whether the old place was shown without it as well


class CarryScores(NamedTuple):
    """Counts and errors of the carries of one or more rooms."""

    num_known: int  # evaluated carries of objects that were in the map, or tracked, before
    num_kept: int  # of these, with the same number at the new place
    num_both_seen: int  # of `num_known`, with both ends seen
    num_both_kept: int  # of these, with the same number at the new place
    put_down_m: FloatArray  # (M,) errors of the centers of objects found at the new place
    num_handled: int  # times that an object was called handled or moved
    num_false: int  # of these, nobody had touched the object


def true_carries(truth: RoomTruth, sequence: BagSequence) -> list[TrueCarry]:
    """Return all carries, in order of objects and time; the last ones may not end."""
    stage, frames = truth.stage, truth.stage.config.frames
    out = []
    for k, (placed, track) in enumerate(zip(stage.world.props, stage.objects, strict=True)):
        centers_m = _centers_m(placed, track)
        change = np.diff(track.handled[:frames].astype(int), prepend=0, append=0)
        grips, ends = (np.flatnonzero(change == step).tolist() for step in (1, -1))
        next_grips = [*grips[1:], frames][: len(grips)]
        begins = [0, *ends][: len(grips)]
        for begin, first, end, until in zip(begins, grips, ends, next_grips, strict=True):
            at_m = centers_m[[first - 1, end]]
            old_m, new_m = se3.transform(se3.inverse(truth.T_world_map), at_m)
            name = placed.prop.class_name
            is_shown = bool(
                name
                and np.linalg.norm(at_m[1] - at_m[0]) >= _MOVED_M
                and _shown_s(truth, sequence, name, at_m[0], begin, first) >= _BEFORE_S
                and _shown_s(truth, sequence, name, at_m[1], end, until) >= _AFTER_S
            )
            is_both_seen = is_shown and _empty_s(truth, at_m[0], first, until) >= _EMPTY_S
            out.append(TrueCarry(k, name, first, end, until, old_m, new_m, is_shown, is_both_seen))
    return out


def _centers_m(placed: PlacedProp, track: ObjectTrack) -> FloatArray:
    """Return the centers (N, 3) of the box of a movable object in the world frame, by frame."""
    vertices_m = placed.prop.mesh.vertices_m
    middle = (vertices_m.min(axis=0) + vertices_m.max(axis=0)).astype(np.float64) / 2
    T = track.T_world_object
    return np.asarray(T[:, :3, :3] @ middle + T[:, :3, 3])


def _shown_s(
    truth: RoomTruth, sequence: BagSequence, name: str, place_m: FloatArray, first: int, end: int
) -> float:
    """Return for how long [s] an object is shown large and near at a place, between two frames."""
    config, count = truth.stage.config, 0
    boxes_at: Mapping[int, Detections] = sequence.true_detections or {}
    for i in range(first, end):
        boxes = boxes_at.get(config.stamp_ns(i))
        T_camera_world = se3.inverse(truth.stage.T_world_camera[i])
        point = se3.transform(T_camera_world, place_m[None])
        if boxes is None or not 0 < point[0, 2] < _RANGE_M:
            continue
        u, v = config.camera.project_px(point)[0]
        of_class = np.array([other == name for other in boxes.class_names], bool)
        x1, y1, x2, y2 = boxes.boxes_xyxy_px.T
        is_large = (x2 - x1) * (y2 - y1) >= _MIN_BOX_PX * config.scale**2
        count += bool((of_class & is_large & (x1 <= u) & (u < x2) & (y1 <= v) & (v < y2)).any())
    return count / config.rate_hz


def _empty_s(truth: RoomTruth, place_m: FloatArray, first: int, end: int) -> float:
    """Return for how long [s] images show through a place between two frames."""
    stage, config = truth.stage, truth.stage.config
    size_px = config.camera.width_px, config.camera.height_px
    static, count = Tracer(stage.static_mesh.vertices_m, stage.static_mesh.faces), 0
    step = max(_EVERY // config.every, 1)
    for i in range(first, end, step):
        T_world_camera = stage.T_world_camera[i]
        point = se3.transform(se3.inverse(T_world_camera), place_m[None])
        if not 0 < point[0, 2] < _RANGE_M:
            continue
        uv = config.camera.project_px(point)[0]
        moving = stage.moving_mesh(i)
        if not ((uv >= 0) & (uv < size_px)).all() or moving is None:
            continue
        origin_m = T_world_camera[None, :3, 3].astype(np.float32)
        offset_m = (place_m - origin_m).astype(np.float32)
        tracers = static, Tracer(moving.vertices_m, moving.faces)
        count += not any(tracer.occluded(origin_m, offset_m)[0] for tracer in tracers)
    return count * step / config.rate_hz


def score_carries(history: History, carries: list[TrueCarry], truth: RoomTruth) -> CarryScores:
    """Return how the objects of a map, or the tracks, followed the carries."""
    num_known = num_kept = num_both_seen = num_both_kept = 0
    errors_m = []
    for carry in carries:
        if not carry.is_shown:
            continue
        before = _found(history, truth, carry, carry.from_map_m, carry.first)
        if before is None:
            continue
        after = _found(history, truth, carry, carry.to_map_m, carry.until)
        is_kept = after is not None and after.number == before.number
        num_known, num_kept = num_known + 1, num_kept + is_kept
        num_both_seen += carry.is_both_seen
        num_both_kept += carry.is_both_seen and is_kept
        if after is not None:
            errors_m.append(float(np.linalg.norm(after.center_map_m - carry.to_map_m)))
    departures = list(_departures(history))
    num_false = sum(not _is_true(d, carries, truth) for d in departures)
    return CarryScores(
        num_known,
        num_kept,
        num_both_seen,
        num_both_kept,
        np.array(errors_m),
        len(departures),
        num_false,
    )


def _found(
    history: History, truth: RoomTruth, carry: TrueCarry, place_m: FloatArray, end: int
) -> Placed | None:
    """Return the object that is at a true place (3,) just before a frame, or None."""
    limit_ns = truth.stage.config.stamp_ns(end)
    stamps = [stamp_ns for stamp_ns in history if stamp_ns < limit_ns]
    near = [
        (float(np.linalg.norm(item.center_map_m - place_m)), item)
        for item in (history[max(stamps)] if stamps else ())
        if item.state.is_at_rest and item.class_name == carry.class_name
    ]
    distance_m, found = min(near, key=lambda pair: pair[0], default=(np.inf, None))
    return found if distance_m < _SAME_M else None


class _Departure(NamedTuple):
    """The time at which an object was first called handled or moved, after it was at rest."""

    class_name: str
    from_map_m: FloatArray  # (3,) its center before
    last_ns: int  # stamp of its last sighting before
    stamp_ns: int


def _departures(history: History) -> Iterator[_Departure]:
    before: dict[int, Placed] = {}
    for stamp_ns in sorted(history):
        objects = {item.number: item for item in history[stamp_ns]}
        for item in objects.values():
            old = before.get(item.number)
            if old is None:
                continue
            is_taken = item.state is ObjectState.HANDLED is not old.state
            is_elsewhere = item.moved_ns != old.moved_ns and old.state is not ObjectState.HANDLED
            if is_taken or is_elsewhere:
                yield _Departure(old.class_name, old.center_map_m, old.last_ns, stamp_ns)
        before = objects


def _is_true(departure: _Departure, carries: list[TrueCarry], truth: RoomTruth) -> bool:
    """Return whether a person had taken the object, or one of its class, from its place."""
    stamp_of = truth.stage.config.stamp_ns
    return any(
        carry.class_name == departure.class_name
        and np.linalg.norm(carry.from_map_m - departure.from_map_m) < _SAME_M
        and stamp_of(carry.first) <= departure.stamp_ns
        and stamp_of(carry.end) >= departure.last_ns - _HIDDEN_S * 1e9
        for carry in carries
    )


def count_filled(true: Sequence[TrueObject], points_map_m: FloatArray) -> tuple[int, int]:
    """Return how many carried objects the dense map shows at their last place, and of how many.

    Args:
        true: The true objects, of which those that were carried and shown long enough count.
        points_map_m: (N, 3) points of the dense map.
    """
    carried = [item for item in true if item.was_carried and item.is_expected]
    if not carried or len(points_map_m) == 0:
        return 0, len(carried)
    tree = cKDTree(points_map_m)
    shares = [
        np.isfinite(tree.query(item.seen_m, distance_upper_bound=_NEAR_M)[0]).mean()
        for item in carried
    ]
    return sum(bool(share >= _FILLED_SHARE) for share in shares), len(carried)
