"""Scenario `alike`: places that look like others far away, which must not be joined with them.

Two floors have most of their landmarks in common, and a corridor looks the same every few meters.
The camera comes back to places it has seen on the same floor and in the same corridor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hoid_benchmarks.building.drive import Drive
from hoid_benchmarks.building.report import Outcome
from hoid_benchmarks.building.tours.revisits import revisits
from hoid_benchmarks.building.tours.tour import is_connected, length_m, tour_route
from hoid_benchmarks.building.world.camera import FeatureCamera
from hoid_benchmarks.building.world.floors import Building
from hoid_benchmarks.building.world.route import Route

WORLDS = ('floors', 'corridor')
OWN = 0.3
"""Landmarks of its own that each floor has, per common one: 23 % of all."""
PERIOD_M, CORRIDOR_M = 4.0, 62.0
_SPEED_MPS = 1.0
_FLOOR_M, _CORRIDOR_WAY_M = 110.0, 300.0
_ROUNDS = ((2, 1), (1, 2), (3, 2))  # columns and rows of blocks, on each floor
_COLUMNS = {
    'world': '',
    'way m': '.0f',
    'keyframes': 'd',
    'images lost': 'd',
    'joins': 'd',
    'false joins': 'd',
    'revisits': 'd',
    'not connected': 'd',
    'ATE mm': '.1f',
    'ATE online mm': '.1f',
    'rigid to': '.0e',
    'keyframe ms': '.0f',
}


def alike(seed: int, worlds: Sequence[str] = WORLDS) -> Outcome:
    """Return joins and errors in each world."""
    return Outcome(
        'alike', 'Places that look alike', _COLUMNS, [_drive(world, seed) for world in worlds]
    )


def corridor_building(seed: int) -> Building:
    """Return a ring of corridors, of which the long ones look the same every 4 m."""
    return Building(1, 1, seed=seed, block_m=(CORRIDOR_M, 12.0), period_m=PERIOD_M)


def floors_building(seed: int, own: float = OWN) -> Building:
    """Return two floors that look alike."""
    return Building(4, 3, floors=2, seed=seed, alike_share=0.0, floors_alike=own)


def _drive(world: str, seed: int) -> dict[str, Any]:
    if world == 'floors':
        building = floors_building(seed)
        route = tour_route(building, _FLOOR_M, _ROUNDS, _SPEED_MPS)
    else:
        building = corridor_building(seed)
        route = Route(building, speed_mps=_SPEED_MPS)
        while length_m(route.poses()) < _CORRIDOR_WAY_M:
            route.around(1, 1)
    truth = route.trajectory(seed)
    with Drive(FeatureCamera(building, seed), truth) as drive:
        drive.run()
        drive.session.map.finish()
        found, atlas = revisits(truth), drive.session.map.atlas
        return {
            'world': world,
            'way m': length_m(truth.T_world_camera),
            'keyframes': drive.num_keyframes,
            'images lost': drive.num_lost,
            'joins': len(drive.joins),
            'false joins': drive.num_false_joins,
            'revisits': len(found),
            'not connected': sum(not is_connected(atlas, revisit) for revisit in found),
            'ATE mm': 1e3 * drive.ate_m(),
            'ATE online mm': 1e3 * drive.ate_m('online'),
            'rigid to': drive.rigid_error(),
            'keyframe ms': float(np.median([answer.cpu_ms for answer in drive.worker.answers])),
            'join list': [join._asdict() for join in drive.joins],
        }
