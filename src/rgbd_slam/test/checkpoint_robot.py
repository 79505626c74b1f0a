"""A map that changes, and the checkpoint that is written of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from hoid_common import se3
from rgbd_slam.model.map_state import restore, snapshot
from rgbd_slam.store.running_map import RunningMap
from rgbd_slam.store.tables import MapHeader

from .map_content import OCTAVES, SCALE, new_map, ring
from .ring_world import CAMERA, MODEL, RingWorld, mapped, ring_poses

T_MAP_CORE = se3.exp(np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0]))
HEADER = MapHeader(MODEL, SCALE, OCTAVES, T_MAP_CORE)


class Robot:
    """A mapper, the tracker's copy of its map, and the database of the copy."""

    def __init__(self, folder: Path, count: int = 8) -> None:
        self.mapper, self.copy = ring(count), new_map()
        self.running = RunningMap(str(folder), 'robot')
        self.writer = self.running.writer(self.copy)
        self.update()

    def update(self) -> None:
        """Send the changes of the mapper's map to the copy."""
        version = self.copy.version if len(self.copy.keyframes) else 0
        self.copy.apply(self.mapper.changes_since(version))

    def write(self, stamp_ns: int = 7) -> int:
        """Write a checkpoint; return the number of its parts."""
        self.writer.begin()
        for count in range(1, 1000):
            header = HEADER._replace(stamp_ns=stamp_ns)
            if self.writer.append(self.writer.copy(), header):
                return count
        raise AssertionError('it never ends')

    def expected(self) -> str:
        return snapshot(self.copy).moved(T_MAP_CORE).digest()

    def stored(self) -> str | None:
        content = self.running.read()
        return None if content is None else content.map.digest()


def extend(robot: Robot, first: int, end: int) -> None:
    """Map further keyframes of the ring."""
    poses = ring_poses(36)[first:end]
    map_id = 1 + int(robot.mapper.keyframes.map_id.max())
    mapped(robot.mapper, RingWorld(600), poses, poses, map_id)
    robot.update()


def change_points(robot: Robot) -> None:
    points = robot.mapper.points
    j = points.indices()[::7]
    robot.mapper.set_positions(j, points.position_m[j] + 0.01)
    robot.mapper.remove_points(points.indices()[::11])
    robot.update()


def move_keyframes(robot: Robot) -> None:
    rows = robot.mapper.keyframes.indices()[2:5]
    robot.mapper.move(rows, np.array([se3.exp(np.full(6, 0.01))] * len(rows)))
    robot.update()


def cull(robot: Robot) -> None:
    robot.mapper.remove_keyframe(int(robot.mapper.keyframes.indices()[3]))
    robot.update()


def forbid(robot: Robot) -> None:
    robot.mapper.forbid_seeds(1, np.arange(5))
    robot.update()


def cull_and_extend(robot: Robot) -> None:
    cull(robot)
    extend(robot, 8, 9)


def load(robot: Robot) -> None:
    """Replace the map by a saved one, of whose keyframes none has an old number."""
    restore(robot.mapper, snapshot(ring(5)), CAMERA, keep=False)
    robot.update()


CHANGES: dict[str, Callable[[Robot], None]] = {
    'new keyframes': lambda robot: extend(robot, 8, 10),
    'points': change_points,
    'a loop': move_keyframes,
    'a culled keyframe': cull,
    'verdicts': forbid,
    'a reused row': cull_and_extend,
    'a loaded map': load,
}
