"""A lost camera is located where its view is unique in the map."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.places.place_finder import PlaceFinder

from .ring_world import CAMERA, RingWorld, mapped, ring_poses


def test_a_lost_frame_is_located() -> None:
    world, atlas = RingWorld(), Atlas(1.2, 8)
    truth = ring_poses(24)
    mapped(atlas, world, truth, truth)
    finder = PlaceFinder(atlas, CAMERA, SlamConfig().places, 0)
    between = truth[7] @ se3.exp(np.array([0.02, 0.1, 0.05, 0.1, 0.05, -0.1]))
    place = finder.locate(world.frame(between, 99)[0])
    assert place is not None
    np.testing.assert_allclose(place.match.T_map_camera, between, atol=5e-3)


def test_a_foreign_view_is_not_located() -> None:
    atlas, truth = Atlas(1.2, 8), ring_poses(24)
    mapped(atlas, RingWorld(), truth, truth)
    finder = PlaceFinder(atlas, CAMERA, SlamConfig().places, 0)
    assert finder.locate(RingWorld(seed=5).frame(truth[3], 99)[0]) is None


def test_of_two_identical_places_neither_is_returned() -> None:
    world, atlas = RingWorld(count=1500), Atlas(1.2, 8)
    half_turn = np.array([-1.0, 1.0, -1.0])
    world.points_m = np.concatenate([world.points_m, half_turn * world.points_m])
    world.descriptors = np.tile(world.descriptors, (2, 1))
    truth = ring_poses(24)
    mapped(atlas, world, truth, truth)
    finder = PlaceFinder(atlas, CAMERA, SlamConfig().places, 0)
    assert finder.locate(world.frame(truth[3], 99)[0]) is None
