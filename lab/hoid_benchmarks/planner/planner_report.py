"""`hoid bench planner`: drives among people, with and without the masks of `navigation`.

The planner knows the true places of the people, so that only the masks are compared. Rooms and
motions are those of rendered scenes; the people walk, stand and carry things, and do not notice
the robot.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from tqdm import tqdm

from hoid_benchmarks.markdown import markdown_table
from hoid_benchmarks.planner.costmap import CELL_M, Costmap, cell_of, centers_m
from hoid_benchmarks.planner.drive import Drive, Layers, drive
from hoid_common.values import BoolArray, FloatArray
from hoid_synth.config import SceneConfig
from hoid_synth.room_truth import RoomTruth

NUM_ROOMS = 8
_PEOPLE = 2
_STARTS_S = (20.0, 30.0, 40.0, 50.0)  # of the drives of a room, chosen
_LONGEST_S = 31.0  # of a drive
_WAY_M = 3.0  # smallest distance between start and goal
_HEADER = (
    'planner', 'drives', 'reached', 'time to the goal s', 'nearest gap m', 'while moving m',
    'intrusions', 'drives with one',
)  # fmt: skip


def planner_report(seeds: Sequence[int]) -> str:
    """Return a Markdown table of all drives.

    Args:
        seeds: Seeds of the rooms.
    """
    drives: dict[Layers, list[Drive]] = {layers: [] for layers in Layers}
    for seed in tqdm(seeds, 'rooms', unit=' rooms'):
        for layers, done in _room(seed):
            drives[layers].append(done)
    return markdown_table(_HEADER, (_cells(k.value, v) for k, v in drives.items()))


def _room(seed: int) -> Iterator[tuple[Layers, Drive]]:
    """Yield the drives in one room: each with both planners, at the same time."""
    frames = round((_STARTS_S[-1] + _LONGEST_S) * 30)
    scene = SceneConfig(seed=seed, num_people=_PEOPLE, num_frames=frames, width_px=64)
    truth = RoomTruth(scene, np.eye(4))
    truth.T_world_map = np.eye(4)
    *_, width_m, depth_m = truth.stage.world.rooms[0]
    shape = int(np.ceil(depth_m / CELL_M)), int(np.ceil(width_m / CELL_M))
    is_occupied = truth.occupied(np.eye(4), shape, CELL_M)
    is_occupied[[0, -1]] = is_occupied[:, [0, -1]] = True  # the walls
    rng = np.random.default_rng([seed, 6])
    for start_s in _STARTS_S:
        way_m = _way_m(is_occupied, rng)
        for layers in Layers:
            yield layers, drive(truth.stage, is_occupied, layers, way_m, start_s)


def _way_m(is_occupied: BoolArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return start and goal (2,) of a drive, far from each other and connected."""
    costmap = Costmap.of(is_occupied)
    free = centers_m((is_occupied.shape[0], is_occupied.shape[1]))[~costmap.is_blocked]
    while True:
        start_m, goal_m = free[rng.integers(0, len(free), 2)]
        is_far = np.linalg.norm(goal_m - start_m) >= _WAY_M
        if is_far and np.isfinite(costmap.to_go(cell_of(goal_m))[cell_of(start_m)]):
            return start_m, goal_m


def _cells(name: str, drives: Sequence[Drive]) -> tuple[str, ...]:
    durations_s = np.array([done.duration_s for done in drives])
    reached = np.isfinite(durations_s)
    nearest_m = [done.nearest_m for done in drives]
    moving_m = [done.moving_m for done in drives if np.isfinite(done.moving_m)]
    num_intrusions = [done.num_intrusions for done in drives]
    return (
        name,
        str(len(drives)),
        str(np.count_nonzero(reached)),
        f'{np.median(durations_s[reached]):.1f}' if reached.any() else '-',
        f'{np.median(nearest_m):.2f}',
        f'{np.median(moving_m):.2f}' if moving_m else '-',
        str(sum(num_intrusions)),
        str(np.count_nonzero(num_intrusions)),
    )
