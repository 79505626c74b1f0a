"""Scenario `merge`: maps of several drives as one, and maps that must stay apart.

Two drives in the same corridor are tiled to maps of thousands of keyframes of which only the first
copies show the same place. Maps of rooms that look alike, on several floors and in several blocks,
show no common place, and neither do those of floors that look alike and of halves of a corridor
with a pattern.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from hoid_benchmarks.building.drive import Drive
from hoid_benchmarks.building.growth import driven_map
from hoid_benchmarks.building.report import Outcome
from hoid_benchmarks.building.tiled_map import tiled_to
from hoid_benchmarks.building.tours.alike import corridor_building, floors_building
from hoid_benchmarks.building.world.camera import FeatureCamera
from hoid_benchmarks.building.world.floors import Building, CellKey, CellKind
from hoid_benchmarks.building.world.route import Route
from hoid_common import se3
from hoid_common.values import FloatArray, IntArray, Trajectory
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.map_joining import join_maps
from rgbd_slam.store.map_file import MapFile

SIZE = 2000
NUM_ROOMS = 7  # 21 pairs
OWN_SHARES = (0.15, 0.5)
"""Landmarks of its own that a floor has, per landmark that both have: 13 and 33 % of all."""
_COLUMNS = {
    'maps': '',
    'keyframes': 'd',
    'pairs': 'd',
    'joined': 'd',
    'wrong': 'd',
    'found %': '.0f',
    'longest s': '.1f',
    'error mm': '.1f',
    'disagreement mm': '.1f',
}


def merge(seed: int, size: int = SIZE, num_rooms: int = NUM_ROOMS) -> Outcome:
    """Return whether maps that show a common place are joined, and others not.

    Args:
        seed: Seed of building, routes and cameras.
        size: Keyframes of each of two maps with a common part.
        num_rooms: Number of rooms of which maps are compared.
    """
    return Outcome(
        'merge',
        'Joined maps (CPU time, one core)',
        _COLUMNS,
        [_overlapping(seed, size), *_apart(seed, num_rooms), *_alike(seed)],
    )


def _overlapping(seed: int, size: int) -> dict[str, Any]:
    building = Building(seed=seed)
    drives = [driven_map(building, seed + n) for n in range(2)]
    maps = [tiled_to(base, size, seed + n) for n, (_, _, base) in enumerate(drives)]
    start_s = time.process_time()
    joined = join_maps(maps, SlamConfig())
    elapsed_s = time.process_time() - start_s
    (join,) = joined.joins
    errors_m = [_error_m(drives, joined.content, size=len(maps[0].map))] if join.is_joined else []
    return {
        'maps': 'with a common part',
        'keyframes': len(maps[0].map),
        'pairs': 1,
        'joined': int(join.is_joined),
        'wrong': sum(error_m > 0.5 for error_m in errors_m),
        'found %': 100 * max(fit.found_share for fit in join.fits) if join.fits else None,
        'longest s': elapsed_s,
        'error mm': 1e3 * errors_m[0] if errors_m else None,
        'disagreement mm': None if join.disagreement_m is None else 1e3 * join.disagreement_m,
        'links': len(join.links),
    }


def _error_m(
    drives: list[tuple[Trajectory, int, MapFile]], content: MapFile, *, size: int
) -> float:
    """Return the median error of the relative positions of the keyframes of two drives.

    The first keyframes of each map are those that were driven; the saved keyframes of the second
    map come first, because it was restored before the first one.
    """
    state, poses = content.map, []
    (truth_a, _, base_a), (truth_b, _, base_b) = drives
    second_first = len(state) - size
    for truth, base, first in ((truth_a, base_a, second_first), (truth_b, base_b, 0)):
        rows = first + np.arange(len(base.map))
        T_true = _true_poses(truth, base.map.stamp_ns)
        poses.append(state.T_map_camera[rows] @ se3.inverse(T_true))
    # T_map_world by each keyframe; the two drives should agree on it.
    T_map_world = poses[0][len(poses[0]) // 2]
    offset = se3.inverse(T_map_world) @ poses[1]
    return float(np.median(np.linalg.norm(offset[:, :3, 3], axis=1)))


def _true_poses(truth: Trajectory, stamps_ns: IntArray) -> FloatArray:
    return truth.T_world_camera[np.searchsorted(truth.stamps_ns, stamps_ns)]


def _apart(seed: int, num_rooms: int) -> list[dict[str, Any]]:
    """Compare maps of rooms that look alike, pair by pair."""
    building = Building(2, 1, floors=2, seed=seed, alike_share=1.0, num_templates=1)
    # One room of each corridor, so that no two routes show the same corridor.
    keys = [key for key in building.cells if key.kind is CellKind.ROOM and not key.east]
    keys = keys[:num_rooms]
    maps = [_map_of(building, key, seed + n) for n, key in enumerate(keys)]
    return [_compared('of look-alike rooms', list(combinations(maps, 2)))]


def _alike(seed: int) -> list[dict[str, Any]]:
    """Compare maps of floors that look alike, and of the two halves of a corridor."""
    rows = []
    for own in OWN_SHARES:
        building = floors_building(seed, own)
        maps = [_map_along(Route(building, floor=n, speed_mps=1.0), seed + n) for n in range(2)]
        share = round(100 * own / (1 + own))
        rows.append(_compared(f'of floors with {share} % of their own', [(maps[0], maps[1])]))
    building = corridor_building(seed)
    halves = [
        _map_along(Route(building, speed_mps=1.0), seed + n, part)
        for n, part in enumerate((slice(0, 280), slice(360, None)))
    ]
    return [*rows, _compared('of halves of a corridor', [(halves[0], halves[1])])]


def _compared(maps: str, pairs: Sequence[tuple[MapFile, MapFile]]) -> dict[str, Any]:
    """Join pairs of maps that show no common place, and return how many were joined."""
    num_joined, longest_s, shares = 0, 0.0, list[float]()
    for pair in pairs:
        start_s = time.process_time()
        (join,) = join_maps(pair, SlamConfig()).joins
        num_joined += join.is_joined
        shares += [fit.found_share for fit in join.fits]
        longest_s = max(longest_s, time.process_time() - start_s)
    return {
        'maps': maps,
        'keyframes': round(float(np.mean([len(m.map) for pair in pairs for m in pair]))),
        'pairs': len(pairs),
        'joined': num_joined,
        'wrong': num_joined,
        'found %': 100 * max(shares) if shares else None,
        'longest s': longest_s,
        'error mm': None,
        'disagreement mm': None,
    }


def _map_along(route: Route, seed: int, part: slice = slice(None)) -> MapFile:
    """Drive along the first corridor, and return the map of a part of the images."""
    route.to_junction(1, 0)
    whole = route.trajectory(seed)
    truth = Trajectory(whole.stamps_ns[part], whole.T_world_camera[part])
    return _driven(FeatureCamera(route.building, seed), truth)


def _map_of(building: Building, key: CellKey, seed: int) -> MapFile:
    """Drive into a room, turn around in it, and return the map."""
    row = key.row + key.north
    route = Route(building, key.column, row, floor=key.floor)
    route.visit(key)
    return _driven(FeatureCamera(building, seed), route.trajectory(seed))


def _driven(camera: FeatureCamera, truth: Trajectory) -> MapFile:
    with Drive(camera, truth) as drive:
        drive.run()
        drive.session.map.finish()
        return drive.session.map.export()
