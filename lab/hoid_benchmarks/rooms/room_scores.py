"""Comparison of maps and tracks of a rendered room with the ground truth."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_benchmarks.rooms.room_run import MappedRoom, Tracks
from hoid_common import se3
from hoid_common.values import FloatArray, ObjectState
from hoid_synth.room_truth import RoomTruth
from hoid_synth.truth import people_centers

_NEAR_M = 0.03


class RoomScores(NamedTuple):
    """Scores of maps and tracks; shares are in [0, 1], NaN if there is nothing to evaluate."""

    num_points: int
    near_share: float  # of map points within 3 cm of a static surface
    path_share: float  # of map points where people walked and no static surface is
    grid_share: float  # of known cells that are correct
    level_deg: float  # angle between the vertical of the grid and the true one
    people_m: float  # median distance of person tracks from the nearest person


def score(room: MappedRoom, truth: RoomTruth) -> RoomScores:
    """Return the scores of a mapped room."""
    points_m = room.cloud.points_m.astype(np.float64)
    return RoomScores(
        len(points_m),
        float(np.mean(truth.distance_m(points_m) < _NEAR_M)),
        float(np.mean(truth.on_paths(points_m))),
        _grid_share(room, truth),
        level_error_deg(room, truth.T_world_map[2, :3]),
        _people_m(room.tracks, truth),
    )


def level_error_deg(room: MappedRoom, up_map: FloatArray) -> float:
    """Return the angle between the vertical of the grid and a direction (3,); NaN: no grid."""
    if room.grid is None:
        return float('nan')
    cosine = room.grid.T_map_origin[:3, 2] @ up_map / np.linalg.norm(up_map)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _grid_share(room: MappedRoom, truth: RoomTruth) -> float:
    if room.grid is None:
        return float('nan')
    cells = room.grid.cells
    true = truth.occupied(room.grid.T_map_origin, cells.shape, room.grid.resolution_m)
    known = cells >= 0
    return float(np.mean((cells == 100)[known] == true[known]))


def _people_m(tracks: Tracks, truth: RoomTruth) -> float:
    config = truth.stage.config
    frame_of = {config.stamp_ns(i): i for i in range(config.frames)}
    errors_m = []
    for stamp_ns, objects in tracks.items():
        people_m = people_centers(truth.stage, frame_of[stamp_ns])
        for track in objects:
            if track.state is ObjectState.PERSON and len(people_m):
                at_m = se3.transform(truth.T_world_map, track.position_map_m[None])
                errors_m.append(np.linalg.norm(people_m - at_m, axis=1).min())
    return float(np.median(errors_m)) if errors_m else float('nan')
