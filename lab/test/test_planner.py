"""Ways of the small planner among known obstacles and people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hoid_benchmarks.planner.costmap import CELL_M, Costmap, cell_of, step_down
from hoid_benchmarks.planner.drive import Layers, drive
from hoid_common.values import BoolArray, FloatArray
from hoid_synth.acting.acting import BodyTrack
from hoid_synth.acting.stage import Stage, set_stage
from hoid_synth.config import SceneConfig

SHAPE = (40, 60)  # 4 m x 6 m
START_M, GOAL_M = np.array([1.05, 2.05]), np.array([5.05, 2.05])


def room(*, is_divided: bool = False) -> BoolArray:
    """Return the cells of an empty room, or of one with a wall that leaves a gap at the top."""
    out = np.zeros(SHAPE, bool)
    if is_divided:
        out[:30, 30] = True
    return out


def walked_m(is_occupied: BoolArray) -> FloatArray:
    """Return the positions (N, 2) from start to goal."""
    to_go = Costmap.of(is_occupied).to_go(cell_of(GOAL_M))
    at_m, out = START_M, [START_M]
    while np.linalg.norm(at_m - GOAL_M) > CELL_M and len(out) < 500:
        after_m = step_down(to_go, at_m, 0.05)
        assert after_m is not None
        out.append(at_m := after_m)
    return np.array(out)


def test_the_way_through_an_empty_room_is_straight() -> None:
    way_m = walked_m(room())
    np.testing.assert_allclose(way_m[:, 1], START_M[1], atol=0.01)
    assert way_m[-1] == pytest.approx(GOAL_M, abs=CELL_M)


def test_the_way_around_a_wall_keeps_the_radius_of_the_robot() -> None:
    way_m = walked_m(room(is_divided=True))
    at_wall = way_m[np.abs(way_m[:, 0] - 3.05) < 0.1]
    assert at_wall[:, 1].min() > 3.0 + 0.2 - CELL_M


def test_a_closed_wall_leaves_no_way() -> None:
    closed = room()
    closed[:, 30] = True
    to_go = Costmap.of(closed).to_go(cell_of(GOAL_M))
    assert step_down(to_go, START_M, 0.05) is None


@pytest.fixture(scope='module')
def stage() -> Stage:
    return set_stage(SceneConfig(seed=1, num_people=1, num_frames=1200, width_px=64))


def crossing(stage: Stage, y_m: FloatArray) -> Stage:
    """Return the stage with a person at x = 3 m who is at y (N,) in each frame."""
    xy_m = np.stack([np.full(len(y_m), 3.0), y_m], -1)
    body: BodyTrack = replace(stage.bodies[0], xy_m=xy_m)
    return replace(stage, bodies=(body,))


def test_a_robot_alone_needs_the_time_of_its_speed(stage: Stage) -> None:
    away = crossing(stage, np.full(1200, 60.0))
    for layers in Layers:
        done = drive(away, room(), layers, (START_M, GOAL_M), 1.0)
        assert done.duration_s == pytest.approx(4.0 / 0.5, abs=0.5)
        assert (done.num_intrusions, done.nearest_m > 50) == (0, True)


def test_the_masks_keep_the_robot_out_of_the_way_of_a_person(stage: Stage) -> None:
    """A person crosses the way of the robot when it arrives there."""
    time_s = np.arange(1200) / 30
    meets = crossing(stage, -3.0 + 1.0 * time_s)  # at y = 2 m after 5 s
    plain, masked = (
        drive(meets, room(), layers, (START_M, GOAL_M), 1.0)
        for layers in (Layers.PLAIN, Layers.MASKS)
    )
    assert plain.num_intrusions >= 1
    assert masked.nearest_m > plain.nearest_m
    assert masked.duration_s < np.inf
