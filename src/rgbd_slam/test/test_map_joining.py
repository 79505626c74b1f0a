"""Maps of several sessions become one where they show the same places, and only there."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.map_matching import MapFit
from rgbd_slam.map_joining import join_maps
from rgbd_slam.model.map_state import snapshot
from rgbd_slam.places.geometric_verification import PlaceMatch
from rgbd_slam.places.place_finder import FoundPlace
from rgbd_slam.slam import RgbdSlam
from rgbd_slam.store.map_file import MapFile

from .world import CAMERA, PERIOD_NS, World, sway

CONFIG = SlamConfig()
NONE = np.empty(0, np.int64)
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
    (fit,) = join.fits
    assert len(fit.place.match.k) >= 60
    assert fit.num_places >= 2
    assert fit.num_elsewhere == 0
    assert fit.found_share > 0.95
    assert not fit.doubt
    state = joined.content.map
    assert (state.map_id == 0).all()
    assert len(state) == len(first.map) + len(second.map)
    known = joined.content.keyframes()
    for own, expected in zip(
        joined.uids, (first.map.T_map_camera, START @ second.map.T_map_camera), strict=True
    ):
        found = known.T_map_camera[known.rows_of(own)]
        assert np.abs(found[:, :3, 3] - expected[:, :3, 3]).max() < 0.02
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
    assert [join.joined_with for join in joined.joins] == [(), (0,)]
    assert len(np.unique(joined.content.map.map_id)) == 2
    joined = join_maps([maps[1], maps[0], maps[2]], CONFIG)
    # The second map found the third one, which finds no other place itself.
    assert [join.joined_with for join in joined.joins] == [(2,), (1,)]


def test_maps_of_rooms_that_look_alike_stay_apart_unless_told(first: MapFile) -> None:
    world = World()
    is_other = np.random.default_rng(5).random(len(world.descriptors)) < 0.3
    world.descriptors[is_other] = np.random.default_rng(6).integers(0, 256, (is_other.sum(), 32))
    other = _session(world, START @ sway(60))
    apart, told = (
        join_maps([first, other], CONFIG),
        join_maps([first, other], CONFIG, same=[(0, 1)]),
    )
    for join, is_joined in ((apart.joins[0], False), (told.joins[0], True)):
        assert join.is_joined is is_joined
        assert join.fits[0].found_share == pytest.approx(0.7, abs=0.05)
        assert '% of the expected points' in join.fits[0].doubt
    np.testing.assert_array_equal(np.unique(apart.content.map.map_id), [0, 1])


def test_maps_are_not_joined_that_must_stay_apart(first: MapFile) -> None:
    others = [_session(World(), START @ sway(60)), _session(World(), sway(60) @ START)]
    joined = join_maps([first, *others], CONFIG, apart=[(0, 1)])
    assert [join.joined_with for join in joined.joins] == [(2,), (1,)]
    joined = join_maps([first, *others], CONFIG, apart=[(0, 1), (2, 1), (0, 2)])
    assert not any(join.is_joined for join in joined.joins)


def test_a_map_that_fits_in_several_ways_is_in_doubt() -> None:
    place = FoundPlace(0, PlaceMatch(np.eye(4), np.eye(6), NONE, NONE))
    assert not MapFit(0, place, 6, False, 2, 1.0).doubt
    assert MapFit(0, place, 5, False, 3, 1.0).doubt == '3 of its keyframes fit elsewhere'
    assert MapFit(0, place, 1, False, 0, 1.0).doubt == 'only one place fits'
    assert not MapFit(0, place, 1, True, 0, 1.0).doubt  # there are no more
