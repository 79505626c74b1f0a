"""Scenario `floor`: a rendered floor with people, from images to trajectory, grid and dense map.

A robot visits all rooms. Boxes of people and objects are ground truth.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_benchmarks.building.report import Outcome
from hoid_benchmarks.plan.sequences import Store, scene_of
from hoid_benchmarks.rooms.room_run import map_room
from hoid_benchmarks.rooms.room_scores import score
from hoid_bringup.evaluate.evaluation import evaluate
from hoid_bringup.run.run_config import TRUTH, RunConfig
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_scene.export import write_ply
from hoid_synth.room_truth import RoomTruth

SMALL = 2  # rooms
# Chosen: 6 images per second of 480 x 360 pixels take a third of the time to render.
_SCENE = 'synth-{seed}-path=floor+rooms={rooms}+every=5+people=4+width=480'
_COLUMNS = {
    'rooms': 'd',
    'way m': '.0f',
    'images': 'd',
    'images lost': 'd',
    'keyframes': 'd',
    'loops': 'd',
    'ATE mm': '.1f',
    'voxels': 'd',
    'within 3 cm %': '.2f',
    'where people walked %': '.3f',
    'grid cells right %': '.1f',
}


def floor(seed: int, num_rooms: int, sequences: Path, out: Path) -> Outcome:
    """Return errors of the trajectory, the dense map and the grid of a floor.

    Args:
        seed: Seed of the floor.
        num_rooms: Least number of rooms; from 8 on, two corridors form a ring.
        sequences: Folder of rendered recordings; a missing one is rendered.
        out: Folder for the dense map.
    """
    name = _SCENE.format(seed=seed, rooms=num_rooms)
    sequences.mkdir(parents=True, exist_ok=True)
    scene, store = scene_of(name), Store(Path(), sequences)
    sequence = BagSequence(store.find(name))
    assert scene is not None
    assert sequence.ground_truth is not None
    truth = RoomTruth(scene, T_BODY_OPTICAL)
    config = RunConfig().updated({'filter.strategy': 'hoid+', 'detector.model': TRUTH})
    room = map_room(sequence, config)
    out.mkdir(parents=True, exist_ok=True)
    write_ply(out / f'floor-{seed}-{num_rooms}.ply', *room.cloud)
    scores, T = score(room, truth), truth.stage.T_world_camera
    row: dict[str, Any] = {
        'rooms': num_rooms,
        'way m': float(np.linalg.norm(np.diff(T[:, :2, 3], axis=0), axis=1).sum()),
        'images': len(sequence),
        'images lost': len(sequence) - len(room.trajectory),
        'keyframes': room.stats.num_keyframes,
        'loops': room.stats.num_loops,
        'ATE mm': 1e3 * evaluate(room.trajectory, sequence.ground_truth).ate_rmse_m,
        'voxels': scores.num_points,
        'within 3 cm %': 100 * scores.near_share,
        'where people walked %': 100 * scores.path_share,
        'grid cells right %': 100 * scores.grid_share,
        'people m': scores.people_m,
    }
    return Outcome('floor', 'A rendered floor with people', _COLUMNS, [row])
