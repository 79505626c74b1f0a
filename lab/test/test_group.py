from dataclasses import replace
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.errors import ConfigError
from hoid_common.values import FloatArray
from hoid_synth.acting.routes import FloorMap
from hoid_synth.acting.stage import Stage, set_stage
from hoid_synth.config import FRAME_RATE_HZ, SceneConfig
from hoid_synth.room.layout import PASSAGE_Y_M
from hoid_synth.scene import SceneRenderer
from hoid_synth.truth import object_states

GROUP = SceneConfig(
    num_frames=180, width_px=64, path='xyz', num_people=4, near_m=1.5, together=True
)
SEEDS = (1, 2, 3)
CASES = ((1, 4, 1.5), (1, 1, 1.0), (2, 6, 1.8), (3, 2, 1.0))  # seed, people, distance in m
WITHOUT_XY_M = (  # each person's first and hundredth place, from before there were groups
    (5.9422263, 2.8565678),
    (5.4227925, 2.5586380),
    (3.0180318, 2.9880052),
    (3.0517299, 2.3957588),
    (2.7815659, 4.3102639),
    (2.5006922, 4.8200000),
    (1.9446158, 4.3008484),
    (0.9440549, 4.5403596),
)


_stage = cache(set_stage)  # by configuration: a test may name what another leaves out


def stage(seed: int = 1, num_people: int = 4, near_m: float = 1.5) -> Stage:
    return _stage(replace(GROUP, seed=seed, num_people=num_people, near_m=near_m))


def positions(of: Stage) -> FloatArray:
    return np.stack([body.xy_m for body in of.bodies])  # (P, N, 2)


def carried_points(of: Stage, i: int) -> list[tuple[int, FloatArray]]:
    """Return the holder and the vertices of every object in hand."""
    return [
        (
            int(t.holder[i]),
            se3.transform(t.T_world_object[i], p.prop.mesh.vertices_m.astype(float)),
        )
        for p, t in zip(of.world.props, of.objects, strict=True)
        if t.handled[i]
    ]


@pytest.mark.parametrize('seed', SEEDS)
def test_all_walk_with_one_velocity(seed: int) -> None:
    velocity = np.diff(positions(stage(seed)), axis=1) * FRAME_RATE_HZ
    np.testing.assert_allclose(velocity, np.broadcast_to(velocity[:1], velocity.shape), atol=1e-9)
    np.testing.assert_allclose(velocity[..., 1], 0, atol=1e-9)  # across the view
    speed = np.abs(velocity[0, :, 0])
    assert 0.75 < speed.max() < 0.95
    assert (speed > 0.7).mean() > 0.5


@pytest.mark.parametrize('seed', SEEDS)
def test_they_come_back(seed: int) -> None:
    heading = stage(seed).bodies[0].heading_rad
    assert np.abs(np.cos(heading[[0, -1]])).min() == pytest.approx(1, abs=1e-6)
    assert np.cos(heading[0]) * np.cos(heading[-1]) < 0


def test_the_gait_is_that_of_the_speed() -> None:
    for body in stage().bodies:
        step = np.linalg.norm(np.diff(body.xy_m, axis=0), axis=1)
        np.testing.assert_allclose(np.diff(body.walked_m), step, atol=1e-9)
        assert body.stride[1:][step * FRAME_RATE_HZ > 0.75].min() > 0.9


@pytest.mark.parametrize(('seed', 'num_people', 'near_m'), CASES)
def test_they_keep_clear_of_each_other(seed: int, num_people: int, near_m: float) -> None:
    for one, other in combinations(positions(stage(seed, num_people, near_m)), 2):
        assert np.linalg.norm(one - other, axis=1).min() > 0.7


@pytest.mark.parametrize(('seed', 'num_people', 'near_m'), CASES)
def test_their_way_is_free(seed: int, num_people: int, near_m: float) -> None:
    play = stage(seed, num_people, near_m)
    x1, _, x2, _ = play.world.rooms[0]
    floor = FloorMap(play.world)
    xy = positions(play).reshape(-1, 2)
    assert all(floor.is_free((x, y)) for x, y in xy.tolist())
    assert PASSAGE_Y_M[0] + 0.2 < xy[:, 1].min()
    assert xy[:, 1].max() < PASSAGE_Y_M[1] - 0.2
    for a, b, c, d in play.world.obstacles:
        assert b > PASSAGE_Y_M[1] or d < PASSAGE_Y_M[0] or c <= x1 or a >= x2
    for placed, track in zip(play.world.props, play.objects, strict=True):
        assert track.handled.any() or placed.spot.position_m[1] > PASSAGE_Y_M[1]


def test_they_pass_as_near_as_said() -> None:
    y_m = positions(stage())[..., 1]
    # Distance from the middle of the camera trajectory.
    assert y_m.mean() - 1.0 == pytest.approx(1.5, abs=0.05)
    assert 0.1 < np.ptp(y_m) < 0.4  # a row, loosely two deep


@pytest.mark.parametrize(('seed', 'num_people', 'near_m'), CASES)
def test_some_carry_an_object_all_the_time(seed: int, num_people: int, near_m: float) -> None:
    play = stage(seed, num_people, near_m)
    for i in (0, 90, 180):
        holders = [state.holder for state in object_states(play, i) if state.handled]
        assert len(set(holders)) == len(holders) == (num_people + 1) // 2


@pytest.mark.parametrize('seed', SEEDS)
def test_objects_are_in_hands_and_bump_into_nobody(seed: int) -> None:
    play, people = stage(seed), positions(stage(seed))
    x1, _, x2, _ = play.world.rooms[0]
    for i in range(0, 180, 6):
        for holder, points in carried_points(play, i):
            wrist = play.joints(holder, i).wrists[0]
            assert np.linalg.norm(points - wrist, axis=1).min() < 0.15
            assert x1 < points[:, 0].min() < points[:, 0].max() < x2
            assert points[:, 2].min() > 0
            for n in {0, 1, 2, 3} - {holder}:
                assert np.linalg.norm(points[:, :2] - people[n, i], axis=1).min() > 0.15


@pytest.mark.slow
def test_boxes_tell_what_is_carried() -> None:
    renderer = SceneRenderer(replace(GROUP, seed=1, width_px=160))
    found: set[tuple[str, bool]] = set()
    for i in (30, 90):
        synth = renderer.frame(i)
        held = {s.instance for s in object_states(renderer.stage, i) if s.handled}
        assert [k in held for k in synth.instances] == list(synth.handled)
        found |= set(zip(synth.detections.class_names, synth.handled, strict=True))
    assert any(handled for _, handled in found)
    assert ('person', False) in found


def test_same_seed_same_group_and_other_seeds_others() -> None:
    again = set_stage(stage().config)
    np.testing.assert_array_equal(positions(again), positions(stage()))
    for one, other in zip(again.objects, stage().objects, strict=True):
        np.testing.assert_array_equal(one.T_world_object, other.T_world_object)
    for seed in SEEDS[1:]:
        assert np.abs(positions(stage(seed)) - positions(stage())).max() > 0.05


def test_without_it_nothing_has_changed() -> None:
    play = set_stage(replace(GROUP, seed=2, near_m=1.0, together=False))
    assert play.world.class_names.count('couch') == 1
    at = positions(play)[:, [0, 100]].reshape(-1, 2)
    np.testing.assert_allclose(at, WITHOUT_XY_M, atol=1e-6)
    assert play.static_mesh.vertices_m.astype(float).sum() == pytest.approx(218431.05, abs=0.01)


@pytest.mark.parametrize('bad', [{'path': 'loop'}, {'near_m': 1.9}])
def test_where_a_group_has_no_room_it_is_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match='together'):
        replace(GROUP, **bad)
