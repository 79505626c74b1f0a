"""Small maps to save, and the contents of their files."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from hoid_common import se3
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.depth_view import Surface
from hoid_scene.dense.submap import Evidence, Submap
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.objects.object_map_state import ObjectMapState
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.model.map_state import MapState, snapshot
from rgbd_slam.store import map_file
from rgbd_slam.store.map_file import MapFile

from .object_world import Box, ObjectWorld
from .ring_world import MODEL, RingWorld, mapped, ring_poses

CONFIG = DenseConfig()
OCTAVES = 8
SCALE = 1.2


def new_map() -> Atlas:
    return Atlas(SCALE, OCTAVES)


def ring(count: int = 8, map_id: int = 0, atlas: Atlas | None = None) -> Atlas:
    atlas = new_map() if atlas is None else atlas
    poses = ring_poses(36)[:count]
    mapped(atlas, RingWorld(600), poses, poses, map_id)
    return atlas


def dense_of(count: int = 3) -> SubmapState:
    """Return submaps, each with a wall, anchored to the first keyframes."""
    submaps = [Submap(np.eye(4), n, 0, se3.exp(np.full(6, 0.1 * n)), CONFIG) for n in range(count)]
    for n, submap in enumerate(submaps):
        submap.update(no_evidence(0), surface(n))
    return SubmapState.of_submaps(submaps, np.arange(count), CONFIG)


def surface(seed: int) -> Surface:
    rng = np.random.default_rng(seed)
    points_m = rng.uniform(0.1, 1.4, (500, 3))
    return Surface(points_m, rng.integers(0, 255, (500, 3), np.uint8), np.ones(500))


def no_evidence(count: int) -> Evidence:
    none = np.zeros(count, np.bool_)
    return Evidence(none, none, none)


def objects_of(state: MapState) -> ObjectMapState:
    """Return two objects that were seen from the first keyframe."""
    world = ObjectWorld()
    cup = Box('cup', (1.9, 0.3, -0.45), (2.0, 0.4, -0.3))
    vase = Box('vase', (1.9, -0.5, -0.45), (2.05, -0.35, -0.1))
    world.look(cup, vase, times=4)
    return world.map.export(np.arange(len(state)))


@cache
def content() -> MapFile:
    """Return the contents of a valid map file; do not change them."""
    state = snapshot(ring())
    uids = 3 * np.arange(len(state)) + 7
    loops = (
        LoopEdge(10, 25, se3.exp(np.full(6, 0.1)), np.eye(6), 45, 0.9, 'loop', 0.01, is_used=True),
        LoopEdge(7, 28, se3.exp(np.full(6, 0.2)), np.eye(6), 12, 0.7, 'join', 2.0, is_used=False),
    )
    return MapFile(
        MODEL, SCALE, OCTAVES, state, dense_of(), objects_of(state), uids, loops, 'today', 123
    )


@cache
def saved() -> bytes:
    """Return the bytes of a valid map file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'saved'
        map_file.save(path, content())
        return path.read_bytes()


def write(path: Path, anything: MapFile) -> None:
    """Write a map file without the checks of `save`, so that it may be invalid."""
    map_file._write(path, anything)
