"""A map that changes, and the checkpoint that is written of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from hoid_common import se3
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.depth_view import Surface
from hoid_scene.dense.submap import Evidence, Submap
from rgbd_slam.map_io.checkpoint import CheckpointWriter
from rgbd_slam.map_io.checkpoint_folder import CheckpointFolder
from rgbd_slam.model.map_state import snapshot
from rgbd_slam.store.tables import MapHeader

from .map_content import OCTAVES, SCALE, new_map, ring
from .ring_world import MODEL, RingWorld, mapped, ring_poses

T_MAP_CORE = se3.exp(np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0]))
CONFIG = DenseConfig()
HEADER = MapHeader(MODEL, SCALE, OCTAVES, T_MAP_CORE)


class Robot:
    """A mapper, the tracker's copy of its map, and the checkpoint of the copy."""

    def __init__(self, folder: Path, count: int = 8) -> None:
        self.mapper, self.copy = ring(count), new_map()
        self.folder = CheckpointFolder(str(folder), 'robot')
        self.writer = CheckpointWriter(self.folder, self.copy)
        self.update()

    def update(self) -> None:
        """Send the changes of the mapper's map to the copy."""
        version = self.copy.version if len(self.copy.keyframes) else 0
        self.copy.apply(self.mapper.changes_since(version))

    def write(self, stamp_ns: int = 7) -> int:
        """Write a checkpoint; return the number of its parts."""
        for count in range(1, 1000):
            part = self.writer.parts.copy()
            self.writer.append(part)
            if part.keyframes is not None:
                self.bytes = self.writer.finish(HEADER, part.keyframes, None, stamp_ns)
                return count
        raise AssertionError('it never ends')

    def expected(self) -> str:
        return snapshot(self.copy).moved(T_MAP_CORE).digest()

    def stored(self) -> str | None:
        checkpoint = self.folder.read()
        return None if checkpoint is None else checkpoint.content.map.digest()


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


CHANGES: dict[str, Callable[[Robot], None]] = {
    'new keyframes': lambda robot: extend(robot, 8, 10),
    'points': change_points,
    'a loop': move_keyframes,
    'a culled keyframe': cull,
    'verdicts': forbid,
    'a reused row': cull_and_extend,
}


def surface(seed: int) -> Surface:
    rng = np.random.default_rng(seed)
    points_m = rng.uniform(0.1, 1.4, (500, 3))
    return Surface(points_m, rng.integers(0, 255, (500, 3), np.uint8), np.ones(500))


def no_evidence(count: int) -> Evidence:
    none = np.zeros(count, np.bool_)
    return Evidence(none, none, none)


def submap(anchor_uid: int, seed: int) -> Submap:
    made = Submap(np.eye(4), anchor_uid, 0, se3.exp(np.full(6, 0.1 * seed)), CONFIG)
    made.update(no_evidence(0), surface(seed))
    return made
