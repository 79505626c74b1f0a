"""Heights of the floor below submaps, where a wall in front of the camera serves as the floor."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

from hoid_common.values import CameraModel
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.dense_map import DenseMap
from hoid_scene.dense.depth_view import DepthView
from hoid_scene.dense.fusion import PosedView
from hoid_scene.grid.floor import Floor
from hoid_scene.grid.local_floors import LocalFloors
from hoid_scene.place import Anchor

CAMERA = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
FLOOR_M = 2.01
VIEW = DepthView(np.full((60, 80), 1000 * FLOOR_M, np.uint16), np.zeros((30, 40, 3), np.uint8))


def voxels_of_floor() -> DenseMap:
    voxels = DenseMap(CAMERA, DenseConfig())
    for slot in range(5):
        voxels.integrate(PosedView(VIEW, slot, Anchor(0, 0, np.eye(4), np.eye(4))))
    return voxels


def plane_below(depth_m: float) -> Floor:
    """Return a plane across the optical axis, whose normal points to the camera."""
    T_map_floor = np.diag([1.0, -1.0, -1.0, 1.0])
    T_map_floor[2, 3] = depth_m
    return Floor(T_map_floor)


def test_the_floor_of_a_submap_is_found_near_the_plane() -> None:
    submaps = voxels_of_floor().shown()
    assert len(submaps) > 1
    heights_m = LocalFloors(plane_below(FLOOR_M + 0.06)).heights_m(submaps)
    assert [heights_m[submap] for submap in submaps] == pytest.approx(
        [0.06] * len(submaps), abs=0.01
    )
    too_far = LocalFloors(plane_below(FLOOR_M + 0.3)).heights_m(submaps)
    assert set(too_far.values()) == {0.0}


def test_removed_submaps_are_forgotten() -> None:
    voxels, floors = voxels_of_floor(), LocalFloors(plane_below(FLOOR_M))
    floors.heights_m(voxels.shown())
    removed = weakref.ref(voxels.submaps[0])
    voxels._remove([voxels.submaps[0]])
    floors.heights_m(voxels.shown())
    gc.collect()
    assert removed() is None
