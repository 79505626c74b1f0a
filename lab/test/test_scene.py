from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hoid_benchmarks.rooms.placed_box import least_area_axes
from hoid_common import se3
from hoid_common.values import FloatArray
from hoid_synth.acting.camera_path import loop_line
from hoid_synth.acting.stage import set_stage
from hoid_synth.config import SceneConfig
from hoid_synth.room.world import World
from hoid_synth.scene import SceneRenderer, SynthFrame
from hoid_synth.static_model import StaticModel
from hoid_synth.truth import object_states

SMALL = SceneConfig(seed=1, num_frames=240, width_px=160)


@cache
def renderer() -> SceneRenderer:
    return SceneRenderer(SMALL)


@cache
def frame(i: int) -> SynthFrame:
    return renderer().frame(i)


def world_points(synth: SynthFrame) -> FloatArray:
    camera, z = SMALL.camera, synth.true_depth_m.astype(float)
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    x, y = (u - camera.cx_px) / camera.fx_px * z, (v - camera.cy_px) / camera.fy_px * z
    return se3.transform(synth.T_world_camera, np.stack([x, y, z], -1).reshape(-1, 3))


@pytest.mark.slow
def test_same_seed_gives_the_same_bytes_in_any_order() -> None:
    again = SceneRenderer(SMALL)
    frame(120)
    one, two = frame(60), again.frame(60)  # not the first frame of the one, but of the other
    assert one.frame.image_bgr.tobytes() == two.frame.image_bgr.tobytes()
    assert one.frame.depth_m.tobytes() == two.frame.depth_m.tobytes()
    assert one.detections.boxes_xyxy_px.tobytes() == two.detections.boxes_xyxy_px.tobytes()


@pytest.mark.slow
def test_another_seed_is_another_room() -> None:
    one, other = renderer().stage, set_stage(SceneConfig(seed=2, num_frames=2, width_px=64))
    assert other.world.class_names != one.world.class_names
    assert np.linalg.norm(other.T_world_camera[0] - one.T_world_camera[0]) > 0.05
    assert other.world.wardrobes[0].build != one.world.wardrobes[0].build


@pytest.mark.slow
def test_a_turned_room_has_the_same_furniture_at_other_angles() -> None:
    config = SceneConfig(num_frames=2, width_px=64)
    world, turned = (set_stage(replace(config, turned=is_on)).world for is_on in (False, True))
    for name in ('dining table', 'chair', 'couch', 'tv'):
        one, other = (angle_deg(each, name) for each in (world, turned))
        assert 1 < abs(one - other) < 89  # a quarter turn is none
    for corner in (np.min, np.max):  # all of it is in the room
        one, other = (corner(each.static.vertices_m, axis=0) for each in (world, turned))
        np.testing.assert_allclose(one, other, atol=0.005)


def angle_deg(world: World, class_name: str) -> float:
    """Return the angle of the first object of a class, up to quarter turns."""
    faces = world.static.faces[world.static.instance == world.class_names.index(class_name)]
    axes = least_area_axes(world.static.vertices_m[faces].reshape(-1, 3))
    return float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0])))


@pytest.mark.slow
def test_other_people_share_the_home_and_begin_elsewhere() -> None:
    home = SceneConfig(num_frames=60, width_px=64)
    one, other = (set_stage(c) for c in (home, replace(home, people_seed=3, start_s=1.0)))
    np.testing.assert_array_equal(one.world.static.vertices_m, other.world.static.vertices_m)
    np.testing.assert_allclose(one.T_world_camera[30:], other.T_world_camera[:-30], atol=1e-9)
    for here, there in zip(one.bodies, other.bodies, strict=True):
        assert np.linalg.norm(here.xy_m - there.xy_m, axis=1).max() > 0.1


@pytest.mark.slow
def test_the_image_size_does_not_change_the_scene() -> None:
    small = set_stage(SceneConfig(seed=1, num_frames=240, width_px=64))
    np.testing.assert_array_equal(small.bodies[0].xy_m, renderer().stage.bodies[0].xy_m)
    np.testing.assert_array_equal(
        small.static_mesh.vertices_m, renderer().stage.static_mesh.vertices_m
    )


def test_boxes_enclose_the_visible_pixels() -> None:
    synth = frame(120)
    assert len(synth.instances) >= 3
    for instance, box in zip(synth.instances, synth.detections.boxes_xyxy_px, strict=True):
        rows, columns = np.nonzero(synth.instance_image == instance)
        assert box.tolist() == [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]


@pytest.mark.slow
def test_static_pixels_lie_on_the_static_model_and_people_do_not() -> None:
    synth, stage = frame(120), renderer().stage
    distance = StaticModel(stage).distance_m(world_points(synth)).reshape(synth.true_depth_m.shape)
    held = [
        p.instance
        for p, t in zip(stage.world.props, stage.objects, strict=True)
        if t.handled.any()
    ]
    people = np.isin(synth.instance_image, stage.world.person_instances)
    moving = people | np.isin(synth.instance_image, held)
    assert people.sum() > 100
    assert distance[~moving].max() < 1e-4
    assert np.median(distance[people]) > 0.05


def test_depth_read_agrees_with_the_truth() -> None:
    synth = frame(60)
    valid = synth.frame.depth_m > 0
    error = np.abs(synth.frame.depth_m - synth.true_depth_m)[valid]
    assert 0.85 < valid.mean() < 0.999
    assert np.median(error) < 0.02


def test_handled_objects_move_with_their_holder_and_others_rest() -> None:
    stage = renderer().stage
    assert any(track.handled.any() for track in stage.objects)
    for track in stage.objects:
        step = np.linalg.norm(np.diff(track.T_world_object[:, :3, 3], axis=0), axis=1)
        resting = ~track.handled[:-1] & ~track.handled[1:]
        assert step[resting].max() < 1e-6
        assert step.max() < 0.15  # 4.5 m/s
        for i in np.flatnonzero(track.handled)[::10]:
            person = stage.joints(int(track.holder[i]), int(i)).pelvis
            assert np.hypot(*(track.T_world_object[i, :2, 3] - person[:2])) < 1.3


def test_some_objects_are_never_touched_and_somebody_stands_still() -> None:
    stage = renderer().stage
    assert sum(not track.handled.any() for track in stage.objects) >= 3
    spells = [spell for motion in stage.motions for spell in motion.standing]
    assert max(end - first for first, end in spells) >= 90  # 3 s
    n, (first, end) = next((n, p.standing[0]) for n, p in enumerate(stage.motions) if p.standing)
    xy = stage.bodies[n].xy_m[first + 10 : end - 10]
    assert np.ptp(xy, axis=0).max() < 0.02


def test_states_agree_with_boxes() -> None:
    synth = frame(120)
    held = {state.instance for state in object_states(renderer().stage, 120) if state.handled}
    for instance, handled in zip(synth.instances, synth.handled, strict=True):
        assert handled == (instance in held)


def test_loop_is_long_and_closed() -> None:
    line = loop_line()
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() > 20
    assert np.linalg.norm(line[-1] - line[0]) < 0.02
    stage = set_stage(SceneConfig(path='loop', num_people=0, width_px=64))
    start, end = stage.T_world_camera[20], stage.T_world_camera[-1]
    assert len(stage.T_world_camera) == 1201
    between = np.linalg.norm(stage.T_world_camera[:, :3, 3] - end[:3, 3], axis=1)
    assert between[:120].min() < 0.3  # it comes back to where it was
    assert np.linalg.norm(start[:3, 3] - end[:3, 3]) < 2.0
    np.testing.assert_allclose(np.linalg.det(stage.T_world_camera[:, :3, :3]), 1)


def test_the_second_take_begins_elsewhere_without_a_sign() -> None:
    stage = set_stage(SceneConfig(path='takes', num_people=0, width_px=64, bare=True))
    T, rate_hz, cut = stage.T_world_camera, stage.config.rate_hz, 149
    jump = se3.inverse(T[cut]) @ T[cut + 1]
    assert np.linalg.norm(jump[:3, 3]) > 0.5
    twists = np.array([stage.twist(i) for i in range(len(T) - 1)])
    dps = np.degrees(np.linalg.norm(twists[:, :3], axis=1)) * rate_hz
    assert 100 < dps.max() < 330
    np.testing.assert_allclose(twists[cut], twists[cut - 1])
    for take in (T[: cut + 1], T[cut + 1 :]):
        ahead = take[:, :3, 2] @ take[0, :3, 2]
        assert ahead.min() < -0.5  # it looks in all directions


def test_the_velocity_at_an_image_is_that_of_the_path() -> None:
    stage = set_stage(SceneConfig(path='rpy', num_people=0, width_px=64, pace=0.3))
    around = 0.5 * (stage.twist(10) + stage.twist(11)) * stage.config.rate_hz
    np.testing.assert_allclose(stage.velocity(11), around, atol=0.02)


def test_people_keep_clear_of_the_camera() -> None:
    stage = renderer().stage
    eye = stage.T_world_camera[:, None, :2, 3]
    people = np.stack([body.xy_m for body in stage.bodies], 1)
    assert np.linalg.norm(people - eye, axis=2).min() > 0.45
