"""Scenario `tour`: a drive through corridors and look-alike rooms of several floors.

The mapper takes its own CPU time for each keyframe. Every join is compared with the truth.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hoid_benchmarks.building.drive import Drive
from hoid_benchmarks.building.report import Outcome
from hoid_benchmarks.building.virtual_mapper import Delay
from hoid_benchmarks.building.world.camera import FeatureCamera
from hoid_benchmarks.building.world.floors import Building
from hoid_benchmarks.building.world.route import Route
from hoid_common.values import FloatArray

# Rounds of each floor: columns and rows of blocks. The second round follows a part of the first.
_ROUNDS = ((3, 2), (1, 1))
_COLUMNS = {
    'floors': 'd',
    'way m': '.0f',
    'keyframes': 'd',
    'images lost': 'd',
    'joins': 'd',
    'false joins': 'd',
    'joins without a loop': 'd',
    'ATE mm': '.1f',
    'ATE online mm': '.1f',
    'image ms': '.2f',
    'keyframe ms': '.1f',
}


def tour(seed: int, num_floors: int = 1) -> Outcome:
    """Return joins, errors and CPU times of a tour through so many floors."""
    building = Building(seed=seed, floors=num_floors)
    route = Route(building)
    for floor in range(num_floors):
        for columns, rows in _ROUNDS:
            route.around(columns, rows, rooms=1, every=2)
        if floor + 1 < num_floors:
            route.climb()
    truth = route.trajectory(seed)
    with Drive(FeatureCamera(building, seed), truth, Delay(cpu_factor=1.0)) as drive:
        drive.run()
        drive.session.slam.map.finish()
        row: dict[str, Any] = {
            'floors': num_floors,
            'way m': _length_m(truth.T_world_camera),
            'keyframes': drive.num_keyframes,
            'images lost': sum(not image.is_tracked for image in drive.images),
            'joins': len(drive.joins),
            'false joins': sum(join.is_false for join in drive.joins),
            'joins without a loop': sum(not join.has_left for join in drive.joins),
            'ATE mm': 1e3 * drive.ate_m(),
            'ATE online mm': 1e3 * drive.ate_m('online'),
            'image ms': float(np.median([image.cpu_ms for image in drive.images])),
            'keyframe ms': float(np.median([answer.cpu_ms for answer in drive.worker.answers])),
            'join list': [join._asdict() for join in drive.joins],
        }
    return Outcome('tour', 'A tour through look-alike rooms', _COLUMNS, [row])


def _length_m(T_world_camera: FloatArray) -> float:
    steps = np.diff(T_world_camera[:, :2, 3], axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())
