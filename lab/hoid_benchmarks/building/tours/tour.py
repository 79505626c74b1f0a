"""Scenario `tour`: a drive through corridors and look-alike rooms of several floors.

The mapper takes its own CPU time for each keyframe. Every join is compared with the truth. Where
the way shows a place again, the keyframes should be connected with the earlier ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import Any

import numpy as np

from hoid_benchmarks.building.drive import Drive
from hoid_benchmarks.building.report import Outcome
from hoid_benchmarks.building.tours.revisits import MIN_ELAPSED_S, Revisit, revisits
from hoid_benchmarks.building.virtual_mapper import Delay
from hoid_benchmarks.building.world.camera import FeatureCamera
from hoid_benchmarks.building.world.floors import STOREY_M, Building
from hoid_benchmarks.building.world.route import SPEED_MPS, Route
from hoid_bringup.evaluate.evaluation import evaluate
from hoid_common.values import NS_PER_S, FloatArray, Trajectory
from rgbd_slam.model.atlas import Atlas

DEFAULT_WAY_M = 240.0
# Columns and rows of blocks. Each round has a part in common with those before it.
_ROUNDS = ((3, 2), (1, 1), (5, 3), (2, 2), (7, 5), (4, 1), (8, 6), (3, 3))
_ABOVE_GROUND_M = 1.6  # chosen: more than the height of the camera and less than a storey
_SHARED = 15  # ORB-SLAM3, KeyFrame.cc, UpdateConnections: points that connect two keyframes
_COLUMNS = {
    'floors': 'd',
    'way m': '.0f',
    'keyframes': 'd',
    'images lost': 'd',
    'joins': 'd',
    'false joins': 'd',
    'joins without a loop': 'd',
    'revisits': 'd',
    'not connected': 'd',
    'ATE of a floor mm': '.1f',
    'ATE mm': '.1f',
    'ATE online mm': '.1f',
    'image ms': '.2f',
    'keyframe ms': '.1f',
}


def tour(seed: int, num_floors: int = 1, way_m: float = DEFAULT_WAY_M) -> Outcome:
    """Return joins, errors and CPU times of a tour.

    Args:
        seed: Seed of building, route and camera.
        num_floors: Number of floors, each of which gets the same share of the way.
        way_m: Least length of the way.
    """
    building = Building(seed=seed, floors=num_floors)
    truth = tour_route(building, way_m / num_floors).trajectory(seed)
    with Drive(FeatureCamera(building, seed), truth, Delay(cpu_factor=1.0)) as drive:
        drive.run()
        drive.session.map.finish()
        found = revisits(truth)
        missed = [r for r in found if not is_connected(drive.session.map.atlas, r)]
        final = drive.session.map.trajectory('final')
        floors_mm = [1e3 * _ate_of_floor_m(final, truth, n) for n in range(num_floors)]
        row: dict[str, Any] = {
            'floors': num_floors,
            'way m': length_m(truth.T_world_camera),
            'keyframes': drive.num_keyframes,
            'images lost': drive.num_lost,
            'joins': len(drive.joins),
            'false joins': drive.num_false_joins,
            'joins without a loop': sum(not join.has_left for join in drive.joins),
            'revisits': len(found),
            'not connected': len(missed),
            'ATE of a floor mm': max(floors_mm),
            'ATE mm': 1e3 * drive.ate_m(),
            'ATE online mm': 1e3 * drive.ate_m('online'),
            'image ms': float(np.median([image.cpu_ms for image in drive.images])),
            'keyframe ms': float(np.median([answer.cpu_ms for answer in drive.worker.answers])),
            'ATE of floors mm': floors_mm,
            'not connected list': [r._asdict() for r in missed],
            'join list': [join._asdict() for join in drive.joins],
        }
    return Outcome('tour', 'A tour through look-alike rooms', _COLUMNS, [row])


def tour_route(
    building: Building,
    floor_m: float,
    rounds: Sequence[tuple[int, int]] = _ROUNDS,
    speed_mps: float = SPEED_MPS,
) -> Route:
    """Return a route that repeats the same rounds on each floor of a building.

    Args:
        building: The building.
        floor_m: Least distance travelled on each floor.
        rounds: Columns and rows of blocks of each round.
        speed_mps: Speed between the turns.
    """
    route = Route(building, speed_mps=speed_mps)
    for floor in range(building.floors):
        sizes = cycle(rounds)
        end_m = length_m(route.poses()) + floor_m
        while length_m(route.poses()) < end_m:
            route.around(*next(sizes), rooms=1, every=2)
        if floor + 1 < building.floors:
            route.to_junction(0, floor)
            route.climb()
    return route


def length_m(T_world_camera: FloatArray) -> float:
    """Return the distance travelled along poses (N, 4, 4), without the changes of height."""
    steps = np.diff(T_world_camera[:, :2, 3], axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())


def is_connected(atlas: Atlas, revisit: Revisit) -> bool:
    """Return whether the keyframes of a revisit share points with those of the time before.

    If none of its keyframes is left, the older ones have made them redundant.
    """
    keyframes = atlas.keyframes
    rows = keyframes.indices()
    stamps_s = keyframes.stamp_ns[rows] / NS_PER_S
    own = rows[(stamps_s >= revisit.first_s) & (stamps_s <= revisit.last_s)]
    older = set(rows[stamps_s < revisit.first_s - MIN_ELAPSED_S].tolist())
    return len(own) == 0 or any(
        older.intersection(atlas.covisible(i, _SHARED).tolist()) for i in own.tolist()
    )


def _ate_of_floor_m(estimate: Trajectory, truth: Trajectory, floor: int) -> float:
    """Return the RMSE of the absolute trajectory error on one floor, aligned there."""
    z_m = truth.T_world_camera[:, 2, 3]
    on_floor = (z_m > floor * STOREY_M) & (z_m < floor * STOREY_M + _ABOVE_GROUND_M)
    return evaluate(
        estimate, Trajectory(truth.stamps_ns[on_floor], truth.T_world_camera[on_floor])
    ).ate_rmse_m
