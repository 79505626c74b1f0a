from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hoid_common.errors import ConfigError
from hoid_synth.acting.acting import ObjectTrack
from hoid_synth.acting.seat import seat_motion
from hoid_synth.acting.stage import Stage, set_stage
from hoid_synth.config import CARRIED, EVENTS, SceneConfig
from hoid_synth.scene import SceneRenderer
from hoid_synth.truth import visible_objects


def config(event: str) -> SceneConfig:
    return SceneConfig(
        seed=1, path='xyz', event=event, num_people=0, num_frames=300, width_px=64, near_m=1.5
    )


def mover(stage: Stage) -> ObjectTrack:
    assert stage.mover is not None
    return stage.mover


@pytest.mark.parametrize('event', EVENTS)
def test_an_event_moves_one_thing(event: str) -> None:
    stage = set_stage(config(event))
    assert stage.world.mover is not None
    ((name, _), instance), T = stage.world.mover, mover(stage).T_world_object
    turned = T[:, :3, :3] @ T[:, :3, :3].mT
    np.testing.assert_allclose(turned, np.tile(np.eye(3), (len(T), 1, 1)), atol=1e-12)
    assert np.abs(T - T[0]).max() > 0.2
    # Only what people carry has a name, and is handled.
    assert bool(name) == (event in CARRIED)
    assert len(stage.bodies) == {'carry_screen': 2}.get(event, int(event in CARRIED))
    last = len(T) - 1
    found = visible_objects(stage, last, 0, np.full((48, 64), instance, np.uint8))
    assert found.handled == ((True,) if name else ())


@pytest.mark.slow
@pytest.mark.parametrize('event', ['carry_box', 'cat', 'picture'])
def test_what_an_event_moves_is_seen(event: str) -> None:
    renderer = SceneRenderer(config(event))
    assert renderer.stage.world.mover is not None
    _, instance = renderer.stage.world.mover
    seen = [np.count_nonzero(renderer.frame(i).instance_image == instance) for i in (0, 45, 75)]
    assert max(seen) > 20


def test_who_sits_down_leaves_with_the_chair() -> None:
    stage, seat = set_stage(config('take_chair')), seat_motion(config('take_chair'))
    T = mover(stage).T_world_object
    np.testing.assert_array_equal(mover(stage).handled, np.arange(301) >= seat.grips)
    np.testing.assert_array_equal(T[: seat.grips], np.tile(T[0], (seat.grips, 1, 1)))
    seat_m = T[0, :3, 3] + [0, 0, 0.485]
    # Seated between sitting down and rising: the pelvis over the seat, a thigh's width above.
    sitting = stage.joints(0, seat.rises)
    assert np.linalg.norm((sitting.pelvis - seat_m)[:2]) < 0.15
    assert 0.05 < (sitting.pelvis - seat_m)[2] < 0.12
    assert sitting.forward[1] < -0.99
    assert (sitting.knees[:, 1] < sitting.pelvis[1] - 0.3).all()
    # Carried in both hands, all the way out of view.
    for i in range(seat.grips, 301):
        hands = stage.bodies[0].hands_m[i]
        palms = stage.joints(0, i).wrists
        assert np.linalg.norm(hands - palms, axis=1).max() < 0.12
        assert np.linalg.norm(hands.mean(0) - T[i, :3, 3]) < 0.5
    step_m = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
    assert step_m.max() < 0.06
    assert T[-1, 0, 3] < T[0, 0, 3] - 1.2


def test_an_event_leaves_the_room_as_it_is() -> None:
    plain = set_stage(config('')).world.static
    np.testing.assert_array_equal(
        plain.vertices_m, set_stage(config('robot')).world.static.vertices_m
    )


def test_an_event_beside_a_group_is_refused() -> None:
    with pytest.raises(ConfigError, match='event'):
        SceneConfig(event='door', together=True, near_m=1.5)


GROUP = SceneConfig(
    seed=1, path='xyz', num_people=3, near_m=1.5, together=True, num_frames=90, width_px=64
)


def test_a_play_may_have_begun_and_may_rest_at_first() -> None:
    plain = set_stage(replace(GROUP, num_frames=60))
    shown = set_stage(replace(GROUP, played_s=1.0, rest_s=2.0))  # 30 and 60 frames
    np.testing.assert_array_equal(shown.T_world_camera[:61], plain.T_world_camera)
    for one, other in zip(shown.bodies, plain.bodies, strict=True):
        np.testing.assert_allclose(one.xy_m[:61], np.tile(other.xy_m[30], (61, 1)))
        np.testing.assert_allclose(one.xy_m[60:], other.xy_m[30:61], atol=1e-9)
        assert one.stride[:55].max() == 0
        assert one.stride[66:] == pytest.approx(other.stride[36:61])
    held = [t.T_world_object for t in shown.objects if t.handled.any()]
    assert held
    assert all(np.ptp(T[:61], axis=0).max() == 0 < np.ptp(T[60:], axis=0).max() for T in held)


def test_what_passes_slowly_is_in_view_all_the_time() -> None:
    trolley = replace(config('trolley'), num_frames=90)
    usual = mover(set_stage(trolley)).T_world_object
    slow = mover(set_stage(replace(trolley, speed_mps=0.16))).T_world_object
    fastest_mps = [
        30 * np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).max() for T in (usual, slow)
    ]
    assert 0.55 < fastest_mps[0] < 0.8
    assert 0.15 < fastest_mps[1] < 0.21
    assert np.abs(slow[:, 0, 3] - 3.2).max() < 0.25 < np.abs(usual[:, 0, 3] - 3.2).max()


@pytest.mark.parametrize(
    ('event', 'changes', 'message'),
    [('door', {'speed_mps': 0.1}, 'speed_mps'), ('followed', {'rest_s': 1.0}, 'rest_s')],
)
def test_what_an_event_cannot_do_is_refused(
    event: str, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        replace(config(event), **changes)
