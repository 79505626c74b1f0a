"""Small maps to save, and the contents of their files."""

from __future__ import annotations

import io
import zipfile
from functools import cache
from pathlib import Path

import numpy as np

from hoid_common import se3
from hoid_scene.dense.dense_state import DenseState
from hoid_scene.dense.depth_view import DepthView
from hoid_scene.dense.stored_view import StoredView
from hoid_scene.objects.object_map_state import ObjectMapState
from rgbd_slam.map_io import map_file
from rgbd_slam.map_io.map_file import MapFile
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.map_state import MapState, snapshot

from .object_world import Box, ObjectWorld
from .ring_world import MODEL, RingWorld, mapped, ring_poses

Members = dict[str, bytes]
OCTAVES = 8
SCALE = 1.2


def new_map() -> Atlas:
    return Atlas(SCALE, OCTAVES)


def ring(count: int = 8, map_id: int = 0, atlas: Atlas | None = None) -> Atlas:
    atlas = new_map() if atlas is None else atlas
    poses = ring_poses(36)[:count]
    mapped(atlas, RingWorld(600), poses, poses, map_id)
    return atlas


def dense_of(state: MapState, count: int = 3) -> DenseState:
    rng = np.random.default_rng(1)
    views = [
        StoredView(
            DepthView(
                rng.integers(0, 5000, (15, 20), np.uint16),
                rng.integers(0, 256, (8, 10, 3), np.uint8),
            ),
            n,
            se3.exp(np.array([0, 0, 0.1 * n, 0, 0, 0])),
        )
        for n in range(count)
    ]
    return DenseState.of_views(views, np.arange(len(state)))


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
    return MapFile(MODEL, SCALE, OCTAVES, state, dense_of(state), objects_of(state))


@cache
def saved() -> bytes:
    """Return the bytes of a valid map file."""
    return written(content())


def written(anything: MapFile) -> bytes:
    buffer = io.BytesIO()
    map_file._write(buffer, anything)
    return buffer.getvalue()


def write(path: Path, anything: MapFile) -> None:
    """Write a map file without the checks of `save`, so that it may be invalid."""
    path.write_bytes(written(anything))


def members_of(data: bytes) -> Members:
    """Return the members of a file by name."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}
