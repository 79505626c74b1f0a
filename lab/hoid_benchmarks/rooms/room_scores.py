"""Comparison of maps and tracks of a rendered room with the ground truth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_benchmarks.rooms.room_run import MappedRoom, Tracks
from hoid_common import se3
from hoid_common.values import FloatArray, ObjectState
from hoid_scene.tracks.object_tracker import TrackedObject
from hoid_synth.room_truth import RoomTruth
from hoid_synth.truth import object_states, people_centers

_NEAR_M = 0.03
_SETTLED_FRAMES = 60  # an object is evaluated if put down this long before the end
_SEEN_FRAMES = 30  # and visible in this many frames since
_MOVED_M = 0.12
_SAME_M = 0.3  # a track farther away belongs to another object


class Carried(NamedTuple):
    """An object that was carried to another place, and was visible at that place."""

    class_name: str
    error_m: float  # position error of its track at the end; inf without a track
    keeps_id: bool | None  # whether its track id is the one before; None without a track before


class RoomScores(NamedTuple):
    """Scores of maps and tracks; shares are in [0, 1], NaN if there is nothing to evaluate."""

    num_points: int
    near_share: float  # of map points within 3 cm of a static surface
    path_share: float  # of map points where people walked and no static surface is
    grid_share: float  # of known cells that are correct
    people_m: float  # median distance of person tracks from the nearest person
    carried: tuple[Carried, ...]


def score(room: MappedRoom, truth: RoomTruth, sequence: BagSequence) -> RoomScores:
    """Return the scores of a mapped room."""
    points_m = room.cloud.points_m.astype(np.float64)
    return RoomScores(
        len(points_m),
        float(np.mean(truth.distance_m(points_m) < _NEAR_M)),
        float(np.mean(truth.on_paths(points_m))),
        _grid_share(room, truth),
        _people_m(room.tracks, truth),
        tuple(_carried(room.tracks, truth, sequence)),
    )


def _grid_share(room: MappedRoom, truth: RoomTruth) -> float:
    if room.grid is None:
        return float('nan')
    cells = room.grid.cells
    true = truth.occupied(room.grid.T_map_origin, cells.shape, room.grid.resolution_m)
    known = cells >= 0
    return float(np.mean((cells == 100)[known] == true[known]))


def _people_m(tracks: Tracks, truth: RoomTruth) -> float:
    frame_of = _frames(truth)
    errors_m = []
    for stamp_ns, objects in tracks.items():
        people_m = people_centers(truth.stage, frame_of[stamp_ns])
        for track in objects:
            if track.state is ObjectState.PERSON and len(people_m):
                offset = people_m - _in_world_m(track, truth)
                errors_m.append(np.linalg.norm(offset, axis=1).min())
    return float(np.median(errors_m)) if errors_m else float('nan')


def _carried(tracks: Tracks, truth: RoomTruth, sequence: BagSequence) -> list[Carried]:
    stage, end = truth.stage, truth.stage.config.frames
    before, after = object_states(stage, 0), object_states(stage, end - 1)
    out = []
    for k, track in enumerate(stage.objects):
        handled = np.flatnonzero(track.handled[:end])
        start_m, end_m = (np.array(states[k].center_m) for states in (before, after))
        if len(handled) == 0 or handled[-1] > end - _SETTLED_FRAMES:
            continue
        name = before[k].class_name
        seen = _num_seen(sequence, truth, name, end_m, int(handled[-1]))
        if np.linalg.norm(end_m - start_m) < _MOVED_M or seen < _SEEN_FRAMES:
            continue
        first = _nearest(tracks, truth, name, start_m, int(handled[0]))
        last = _nearest(tracks, truth, name, end_m, end)
        error_m = float('inf')
        if last is not None:
            error_m = float(np.linalg.norm(_in_world_m(last, truth) - end_m))
        keeps = None if first is None else last is not None and last.track_id == first.track_id
        out.append(Carried(name, error_m, keeps))
    return out


def _nearest(
    tracks: Tracks, truth: RoomTruth, class_name: str, place_m: FloatArray, before_frame: int
) -> TrackedObject | None:
    """Return the track of a class at a place (3,) in the last message before a frame, or None."""
    frame_of = _frames(truth)
    earlier = [stamp_ns for stamp_ns in tracks if frame_of[stamp_ns] < before_frame]
    if not earlier:
        return None
    near = [
        (float(np.linalg.norm(_in_world_m(track, truth) - place_m)), track)
        for track in tracks[max(earlier)]
        if track.class_name == class_name
    ]
    distance_m, found = min(near, key=lambda item: item[0], default=(np.inf, None))
    return found if distance_m < _SAME_M else None


def _num_seen(
    sequence: BagSequence, truth: RoomTruth, class_name: str, place_m: FloatArray, after: int
) -> int:
    """Return in how many images after a frame a box of the class covers a place (3,)."""
    frame_of, count = _frames(truth), 0
    for stamp_ns, boxes in (sequence.true_detections or {}).items():
        i = frame_of[stamp_ns]
        point = se3.transform(se3.inverse(truth.stage.T_world_camera[i]), place_m[None])
        if i <= after or point[0, 2] < 0.3:
            continue
        u, v = sequence.camera.project_px(point)[0]
        of_class = np.array([name == class_name for name in boxes.class_names], bool)
        x1, y1, x2, y2 = boxes.boxes_xyxy_px.T
        count += bool((of_class & (x1 <= u) & (u < x2) & (y1 <= v) & (v < y2)).any())
    return count


def _frames(truth: RoomTruth) -> dict[int, int]:
    config = truth.stage.config
    return {config.stamp_ns(i): i for i in range(config.frames)}


def _in_world_m(track: TrackedObject, truth: RoomTruth) -> FloatArray:
    return np.asarray(se3.transform(truth.T_world_map, track.position_map_m[None])[0])
