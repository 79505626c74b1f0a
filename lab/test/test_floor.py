"""The rendered floor: its plan, the drive through it, and the people in it."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common.values import BoolArray, FloatArray
from hoid_synth.acting.routes import FloorMap
from hoid_synth.acting.stage import Stage
from hoid_synth.config import SceneConfig
from hoid_synth.floor.plan import floor_plan
from hoid_synth.floor.route import floor_route
from hoid_synth.mesh import Rect
from hoid_synth.scene import SceneRenderer

SMALL = SceneConfig(seed=1, path='floor', num_rooms=2, every=5, num_people=4, width_px=160)


@pytest.fixture(scope='module')
def renderer() -> SceneRenderer:
    return SceneRenderer(SMALL)


@pytest.fixture(scope='module')
def stage(renderer: SceneRenderer) -> Stage:
    return renderer.stage


def is_in(xy_m: FloatArray, rect: Rect) -> BoolArray:
    return np.asarray((xy_m >= rect[:2]).all(1) & (xy_m <= rect[2:]).all(1))


def test_twelve_rooms_lie_along_a_ring_of_corridors_without_overlap() -> None:
    plan = floor_plan(12)
    assert len(plan.rooms) == 12
    assert [len(plan.rooms_of(k)) for k in range(2)] == [6, 6]
    rects = [room.rect for room in plan.rooms] + list(plan.main)
    for k, (x1, y1, x2, y2) in enumerate(rects):
        for other in rects[k + 1 :]:
            assert other[0] >= x2 or other[2] <= x1 or other[1] >= y2 or other[3] <= y1


def test_the_route_visits_all_rooms_and_ends_where_it_began() -> None:
    route = floor_route(12)
    assert route.length_m > 300
    assert len({visit.room for visit in route.visits}) == 12
    times_s = np.arange(0, route.duration_s, 0.1)
    xy_m, yaw_rad = route.at(times_s)
    assert np.linalg.norm(np.diff(xy_m, axis=0), axis=1).max() < 0.081  # 0.8 m/s
    assert np.degrees(np.abs(np.diff(yaw_rad))).max() < 6.01  # 60 deg/s
    end_m, _ = route.at(np.array([route.duration_s]))
    np.testing.assert_allclose(end_m[0], xy_m[0], atol=1e-9)
    for visit in route.visits:
        inside = is_in(xy_m, visit.room.rect)
        during = (times_s > visit.first_s) & (times_s < visit.last_s)
        assert np.count_nonzero(inside & during) > 20


def test_the_camera_drives_where_nothing_stands(stage: Stage) -> None:
    free = FloorMap(stage.world)
    assert all(free.is_free(xy_m) for xy_m in stage.T_world_camera[:, :2, 3])


def test_every_ray_hits_a_surface(renderer: SceneRenderer) -> None:
    for i in np.linspace(0, SMALL.frames - 1, 8).astype(int).tolist():
        depth_m = renderer.frame(i).true_depth_m
        assert np.isfinite(depth_m).all()
        assert depth_m.min() > 0.1


def test_people_stay_in_the_corridor_or_in_rooms_and_apart_from_the_camera(stage: Stage) -> None:
    camera_m = stage.T_world_camera[:, :2, 3]
    zones = [room.rect for room in floor_plan(2).rooms] + list(floor_plan(2).main)
    for body in stage.bodies:
        inside = np.any([is_in(body.xy_m, zone) for zone in zones], axis=0)
        assert inside.all()
        gap_m = np.linalg.norm(body.xy_m - camera_m[: len(body.xy_m)], axis=1)
        assert np.mean(gap_m < 0.6) < 0.02


def test_a_person_waits_in_the_room_that_the_camera_enters(stage: Stage) -> None:
    hosts, route = stage.bodies[2:], floor_route(2)
    for visit, host in zip(route.visits, hosts, strict=True):
        during = range(round(visit.first_s * SMALL.rate_hz), round(visit.last_s * SMALL.rate_hz))
        assert is_in(host.xy_m[during], visit.room.rect).all()
