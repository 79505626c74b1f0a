"""Small maps to save, and the contents of their files."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from hoid_common import se3
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.model.map_state import snapshot
from rgbd_slam.store import map_file
from rgbd_slam.store.map_file import MapFile

from .ring_world import MODEL, RingWorld, mapped, ring_poses

OCTAVES = 8
SCALE = 1.2


def new_map() -> Atlas:
    return Atlas(SCALE, OCTAVES)


def ring(count: int = 8, map_id: int = 0, atlas: Atlas | None = None) -> Atlas:
    atlas = new_map() if atlas is None else atlas
    poses = ring_poses(36)[:count]
    mapped(atlas, RingWorld(600), poses, poses, map_id)
    return atlas


@cache
def content() -> MapFile:
    """Return the contents of a valid map file; do not change them."""
    state = snapshot(ring())
    uids = 3 * np.arange(len(state)) + 7
    loops = (
        LoopEdge(10, 25, se3.exp(np.full(6, 0.1)), np.eye(6), 45, 0.9, 'loop', 0.01, is_used=True),
        LoopEdge(7, 28, se3.exp(np.full(6, 0.2)), np.eye(6), 12, 0.7, 'join', 2.0, is_used=False),
    )
    return MapFile(MODEL, SCALE, OCTAVES, state, uids, loops, 'today', 123)


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
