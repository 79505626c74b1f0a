"""Maps of several sessions become one where they show the same places, and only there."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closer import LoopEvent
from rgbd_slam.map_io.map_file import MapFile
from rgbd_slam.map_joining import join_maps
from rgbd_slam.model.map_state import snapshot
from rgbd_slam.slam import RgbdSlam

from .world import CAMERA, PERIOD_NS, World, sway

CONFIG = SlamConfig()
START = se3.exp(np.array([0.0, 0.3, 0.0, 0.2, 0.05, 0.1]))  # of the second session


def _session(world: World, poses: FloatArray) -> MapFile:
    """Return the map of a session, in the frame of its first image."""
    slam = RgbdSlam(CAMERA, CONFIG)
    for n, T in enumerate(poses):
        slam.process(world.features(n * PERIOD_NS, T))
    octaves = CONFIG.camera.scale_factor, CONFIG.camera.num_octaves
    return MapFile(CAMERA, *octaves, snapshot(slam.map.atlas))


@pytest.fixture(scope='module')
def first() -> MapFile:
    return _session(World(), sway(60))


def test_two_sessions_in_a_room_are_one_map_in_the_frame_of_the_first(first: MapFile) -> None:
    second = _session(World(), START @ sway(60))
    joined = join_maps([first, second], CONFIG)
    (join,) = joined.joins
    assert join.is_joined
    assert join.links[0].event is LoopEvent.MERGED
    assert join.links[0].num_points >= 60
    state = joined.content.map
    assert (state.map_id == 0).all()
    assert len(state) == len(first.map) + len(second.map)
    # Both sessions have the same stamps; those of the second one are where it was.
    of_first = np.linalg.norm(
        state.T_map_camera[:, None, :3, 3] - first.map.T_map_camera[None, :, :3, 3], axis=-1
    ).min(1)
    expected = START @ second.map.T_map_camera
    of_second = np.linalg.norm(
        state.T_map_camera[:, None, :3, 3] - expected[None, :, :3, 3], axis=-1
    ).min(1)
    assert np.minimum(of_first, of_second).max() < 0.02
    assert (of_second < 0.02).sum() >= len(second.map)


def test_maps_of_different_rooms_stay_apart(first: MapFile) -> None:
    other = _session(World(seed=7), sway(60))
    joined = join_maps([first, other], CONFIG)
    assert not joined.joins[0].is_joined
    assert joined.joins[0].disagreement_m is None
    assert np.bincount(joined.content.map.map_id).tolist() == [len(first.map), len(other.map)]


def test_of_three_maps_each_is_reported(first: MapFile) -> None:
    maps = [first, _session(World(seed=7), sway(60)), _session(World(), START @ sway(60))]
    joined = join_maps(maps, CONFIG)
    assert [join.is_joined for join in joined.joins] == [False, True]
    assert len(np.unique(joined.content.map.map_id)) == 2
