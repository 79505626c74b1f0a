"""A room that was rearranged while nobody watched."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from hoid_common.errors import ConfigError
from hoid_common.values import Float32Array
from hoid_synth.config import FLOOR, SceneConfig
from hoid_synth.room.layout import build_world
from hoid_synth.room.world import World

pytestmark = pytest.mark.slow


@cache
def world(away_seed: int) -> World:
    return build_world(SceneConfig(seed=102, num_frames=2, width_px=64, away_seed=away_seed))


def furniture(room: World) -> dict[int, Float32Array]:
    """Return the corners of the faces of each instance of the furniture."""
    mesh = room.static
    return {
        int(k): mesh.vertices_m[mesh.faces[mesh.instance == k]] for k in np.unique(mesh.instance)
    }


def test_things_are_moved_taken_and_added_and_keep_their_instances() -> None:
    before, after = world(0), world(1)
    old, new = ({item.instance: item for item in room.props} for room in (before, after))
    added = new.keys() - old.keys()
    assert min(added) >= len(before.class_names)
    assert {after.class_names[k] for k in added}.isdisjoint(
        item.prop.class_name for item in before.props
    )
    still, now = furniture(before), furniture(after)
    moved = [k for k in old.keys() & new.keys() if old[k].spot != new[k].spot]
    moved += [k for k in still.keys() & now.keys() if k and not np.array_equal(still[k], now[k])]
    taken = [*(old.keys() - new.keys()), *(still.keys() - now.keys())]
    assert (len(moved), len(taken), len(added)) == (3, 3, 2)
    changed = [after.class_names[k] for k in (*moved, *taken)]
    assert len(set(changed)) == len(changed)  # of two equal things, one cannot say which one


def test_no_two_things_share_a_spot_afterwards() -> None:
    room = world(1)
    spots = [item.spot for item in room.props]
    assert len(set(spots)) == len(spots)
    assert not set(spots) & set(room.spots)


def test_the_rest_of_the_room_stays() -> None:
    before, after = world(0), world(1)
    np.testing.assert_array_equal(furniture(before)[0], furniture(after)[0])
    assert after.class_names[: len(before.class_names)] == before.class_names
    assert world(2).props != after.props


def test_a_floor_of_rooms_cannot_be_rearranged() -> None:
    with pytest.raises(ConfigError, match='away_seed'):
        SceneConfig(path=FLOOR, away_seed=1)
