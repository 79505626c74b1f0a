"""Masks for Nav2's costmap filters, made from tracks with known places."""

from __future__ import annotations

import numpy as np
import pytest
from std_msgs.msg import Header

from hoid_common.errors import ConfigError
from hoid_common.values import NS_PER_S, FloatArray
from hoid_scene.config.navigation_config import NavigationConfig
from hoid_scene.config.scene_config import SceneNodeConfig
from hoid_scene.navigation_masks import Mask, NavigationMasks
from hoid_scene.ros.mask_messages import (
    FilterType,
    filter_info_to_msg,
    mask_to_msg,
)
from hoid_scene.tracks.object_tracker import ObjectState, TrackedObject

CONFIG = NavigationConfig(enabled=True, horizon_s=2.0, margin_m=0.4)
FAR = np.eye(4)
FAR[:3, 3] = -10.0, -10.0, 1.0


def item(
    state: ObjectState,
    at_m: tuple[float, float],
    velocity_mps: tuple[float, float] = (0.0, 0.0),
    class_name: str = 'person',
) -> TrackedObject:
    return TrackedObject(
        1,
        class_name,
        state,
        0,
        0.9,
        np.array([*at_m, 0.9]),
        np.array([*velocity_mps, 0.0]),
        np.array([0.3, 0.4, 0.5]),
    )


def masks_of(
    *tracks: TrackedObject, config: NavigationConfig = CONFIG, T_map_camera: FloatArray = FAR
) -> NavigationMasks:
    masks = NavigationMasks(config)
    assert masks.update(tracks, T_map_camera, NS_PER_S)
    return masks


def value_at(mask: Mask, x_m: float, y_m: float) -> int:
    """Return the value of the cell at a point; 0 beyond the mask, as for Nav2."""
    column, row = (np.floor(np.array([x_m, y_m]) / mask.resolution_m) - mask.low).astype(int)
    height, width = mask.cells.shape
    is_inside = 0 <= row < height and 0 <= column < width
    return int(mask.cells[row, column]) if is_inside else 0


def test_the_way_of_a_walking_person_is_closed_and_not_what_lies_behind() -> None:
    mask = masks_of(item(ObjectState.PERSON, (1.0, 2.0), (1.0, 0.0))).keep_out()
    assert [value_at(mask, x, 2.0) for x in (0.4, 1.05, 2.05, 3.05, 3.55)] == [0, 100, 100, 100, 0]
    assert [value_at(mask, 2.05, y) for y in (1.45, 1.75, 2.25, 2.55)] == [0, 100, 100, 0]


def test_a_standing_person_closes_nothing() -> None:
    mask = masks_of(item(ObjectState.PERSON, (1.0, 2.0), (0.1, 0.0))).keep_out()
    assert mask.cells.shape == (1, 1)
    assert not mask.cells.any()


@pytest.mark.parametrize(
    ('state', 'classes', 'value'),
    [
        (ObjectState.HANDLED, (), 100),
        (ObjectState.HANDLED, ('chair', 'cup'), 100),
        (ObjectState.HANDLED, ('cup',), 0),
        (ObjectState.AT_REST, (), 0),
    ],
)
def test_objects_in_hands_are_kept_away_from_by_class(
    state: ObjectState, classes: tuple[str, ...], value: int
) -> None:
    config = NavigationConfig(enabled=True, margin_m=0.4, classes=classes)
    mask = masks_of(item(state, (0.0, 0.0), class_name='chair'), config=config).keep_out()
    assert value_at(mask, 0.55, 0.0) == value  # half the size, 0.25 m, and the margin
    assert value_at(mask, 0.75, 0.0) == 0


def test_a_robot_is_never_inside_of_a_closed_area() -> None:
    T_map_camera = np.eye(4)
    T_map_camera[:3, 3] = 2.0, 2.0, 1.0
    person = item(ObjectState.PERSON, (1.0, 2.0), (1.0, 0.0))
    mask = masks_of(person, T_map_camera=T_map_camera).keep_out()
    assert value_at(mask, 2.05, 2.05) == value_at(mask, 1.75, 2.0) == 0
    assert value_at(mask, 1.45, 2.0) == 100


def test_speed_falls_with_the_number_of_crossings() -> None:
    config = NavigationConfig(enabled=True, busy_crossings=4, busy_speed_percent=40.0)
    masks = NavigationMasks(config)
    for crossing in range(6):
        for step in range(20):
            x_m = -1.0 + 0.1 * step
            y_m = 0.6 if crossing == 0 else 0.1
            person = item(ObjectState.PERSON, (x_m, y_m), (1.0, 0.0))
            masks.update((person,), FAR, (crossing * 30 + step) * NS_PER_S // 10)
        for _ in range(3):
            masks.update((), FAR, 0)
    mask = masks.speed()
    assert value_at(mask, 0.1, 0.6) == 15  # once of four times; the limit is 100 - 15 %
    assert value_at(mask, 0.1, 0.1) == 60
    assert value_at(mask, 0.1, 2.0) == 0
    for _ in range(50):  # who stands still does not cross again
        masks.update((item(ObjectState.PERSON, (0.1, 0.6)),), FAR, 0)
    assert value_at(masks.speed(), 0.1, 0.6) == 30


def test_masks_are_published_twice_a_second() -> None:
    masks = NavigationMasks(CONFIG)
    assert sum(masks.update((), FAR, i * NS_PER_S // 10) for i in range(50)) == 10


def test_messages_have_the_place_of_the_cells_and_the_meaning_for_nav2() -> None:
    header = Header(frame_id='map')
    cells = np.array([[0, 100, 0], [0, 0, 50]], np.int8)
    msg = mask_to_msg(Mask(cells, 0.25, (-4, 2)), header)
    assert (msg.info.width, msg.info.height, msg.info.resolution) == (3, 2, 0.25)
    assert (msg.info.origin.position.x, msg.info.origin.position.y) == (-1.0, 0.5)
    assert msg.info.origin.orientation.w == 1.0
    assert list(msg.data) == [0, 100, 0, 0, 0, 50]
    info = filter_info_to_msg(FilterType.SPEED_PERCENT, '/robot/speed_mask', header)
    assert (info.type, info.filter_mask_topic) == (1, '/robot/speed_mask')
    assert info.base + 30 * info.multiplier == 70.0
    keep_out = filter_info_to_msg(FilterType.KEEP_OUT, '/keep_out_mask', header)
    assert (keep_out.type, keep_out.base, keep_out.multiplier) == (0, 0.0, 1.0)


def test_masks_need_tracks() -> None:
    values = {'navigation.enabled': True}
    assert SceneNodeConfig().updated(values).navigation.enabled
    with pytest.raises(ConfigError, match='needs objects'):
        SceneNodeConfig().updated(values | {'objects.enabled': False})
