import numpy as np
import pytest

from hoid_common.errors import ConfigError
from hoid_synth.acting.stage import set_stage
from hoid_synth.config import CARRIED, EVENTS, SceneConfig
from hoid_synth.scene import SceneRenderer
from hoid_synth.truth import visible_objects


def config(event: str) -> SceneConfig:
    return SceneConfig(
        seed=1, path='xyz', event=event, num_people=0, num_frames=90, width_px=64, near_m=1.5
    )


@pytest.mark.parametrize('event', EVENTS)
def test_an_event_moves_one_thing(event: str) -> None:
    stage = set_stage(config(event))
    assert stage.world.mover is not None
    assert stage.T_world_mover is not None
    ((name, _), instance), T = stage.world.mover, stage.T_world_mover
    turned = T[:, :3, :3] @ T[:, :3, :3].mT
    np.testing.assert_allclose(turned, np.tile(np.eye(3), (91, 1, 1)), atol=1e-12)
    assert np.abs(T - T[0]).max() > 0.2
    # Only what people carry has a name, and is handled.
    assert bool(name) == (event in CARRIED)
    assert len(stage.bodies) == {'carry_screen': 2}.get(event, int(event in CARRIED))
    found = visible_objects(stage, 0, 0, np.full((48, 64), instance, np.uint8))
    assert found.handled == ((True,) if name else ())


@pytest.mark.slow
@pytest.mark.parametrize('event', ['carry_box', 'cat', 'picture'])
def test_what_an_event_moves_is_seen(event: str) -> None:
    renderer = SceneRenderer(config(event))
    assert renderer.stage.world.mover is not None
    _, instance = renderer.stage.world.mover
    seen = [np.count_nonzero(renderer.frame(i).instance_image == instance) for i in (0, 45, 75)]
    assert max(seen) > 20


def test_an_event_leaves_the_room_as_it_is() -> None:
    plain = set_stage(config('')).world.static
    np.testing.assert_array_equal(
        plain.vertices_m, set_stage(config('robot')).world.static.vertices_m
    )


def test_an_event_beside_a_group_is_refused() -> None:
    with pytest.raises(ConfigError, match='event'):
        SceneConfig(event='door', together=True, near_m=1.5)
