"""Masks for Nav2's costmap filters, made from tracks with known places."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Any, cast

import numpy as np
import pytest
from std_msgs.msg import Header

from hoid_common.errors import ConfigError
from hoid_common.values import NS_PER_S, FloatArray, ObjectState
from hoid_scene.config.navigation_config import NavigationConfig
from hoid_scene.config.scene_config import SceneConfig, SceneNodeConfig
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.grid.grid import Grid, GridExtent
from hoid_scene.navigation_masks import Mask, NavigationMasks, changed_cells
from hoid_scene.ros.map_messages import (
    FilterType,
    filter_info_to_msg,
    mask_to_msg,
)
from hoid_scene.ros.outputs import SceneOutputs
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.tracks.object_track import TrackedObject

from .nav2_costmap import LETHAL, Costmap, cells_of

EXTENT = GridExtent((-100, -100), (200, 200), 0.05)  # 10 m around the origin
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
    *tracks: TrackedObject, config: NavigationConfig = CONFIG, T_map_base: FloatArray = FAR
) -> NavigationMasks:
    masks = NavigationMasks(config)
    assert masks.update(tracks, T_map_base, NS_PER_S)
    return masks


class Recorded:
    """A publisher that keeps its messages, and always has a subscriber."""

    is_wanted = True

    def __init__(self) -> None:
        self.messages: list[Any] = []

    def publish(self, message: Any) -> None:
        self.messages.append(message)


class StillScene:
    """A scene with a grid of free cells."""

    def cloud(self) -> ColoredCloud:
        return ColoredCloud(np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8))

    def label(self, _: ColoredCloud) -> None:
        return None

    def grid(self, _: ColoredCloud) -> Grid:
        return Grid(np.zeros(EXTENT.shape, np.int8), EXTENT.resolution_m, np.eye(4), EXTENT.low)


class Outputs:
    """The outputs of a scene with a grid, and what they have published."""

    def __init__(self, config: NavigationConfig) -> None:
        self._published: defaultdict[str, Recorded] = defaultdict(Recorded)
        self._num_delivered: Counter[str] = Counter()
        self.scene = SceneOutputs(
            lambda output: self._published[output.name], SceneConfig(navigation=config)
        )
        self.scene.frame = 'map'
        self.scene.set_level(is_map_level=True)
        self.scene.note_change()
        self.scene.publish_map(cast(SceneMapper, StillScene()), 0)

    def publish_masks(self, masks: NavigationMasks, stamp_ns: int) -> None:
        self.scene.publish_masks(masks, stamp_ns, lambda topic: f'/{topic}')

    def message(self, topic: str) -> Any:
        return self._published[topic].messages[-1]

    def num_of(self, topic: str) -> int:
        return len(self._published[topic].messages)

    def deliver(self, costmap: Costmap) -> None:
        """Send what was published since the last call to a costmap, masks before updates."""
        for topic, receive in (
            ('keep_out_mask', costmap.on_keep_out),
            ('speed_mask', costmap.on_speed),
            ('grid_map_updates', costmap.on_update),
        ):
            messages = self._published[topic].messages
            for message in messages[self._num_delivered[topic] :]:
                receive(message)
            self._num_delivered[topic] = len(messages)


def value_at(mask: Mask, x_m: float, y_m: float) -> int:
    """Return the value of the cell at a point of the mask."""
    low, _, cell_m = mask.extent
    column, row = (np.floor(np.array([x_m, y_m]) / cell_m) - low).astype(int)
    return int(mask.cells[row, column])


def test_the_way_of_a_walking_person_is_closed_and_not_what_lies_behind() -> None:
    mask = masks_of(item(ObjectState.PERSON, (1.0, 2.0), (1.0, 0.0))).keep_out(EXTENT)
    assert [value_at(mask, x, 2.0) for x in (0.4, 1.05, 2.05, 3.05, 3.55)] == [0, 100, 100, 100, 0]
    assert [value_at(mask, 2.05, y) for y in (1.45, 1.75, 2.25, 2.55)] == [0, 100, 100, 0]


def test_a_standing_person_closes_nothing() -> None:
    mask = masks_of(item(ObjectState.PERSON, (1.0, 2.0), (0.1, 0.0))).keep_out(EXTENT)
    assert mask.cells.shape == (200, 200)
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
    mask = masks_of(item(state, (0.0, 0.0), class_name='chair'), config=config).keep_out(EXTENT)
    assert value_at(mask, 0.55, 0.0) == value  # half the size, 0.25 m, and the margin
    assert value_at(mask, 0.75, 0.0) == 0


def test_a_robot_is_never_inside_of_a_closed_area() -> None:
    T_map_base = np.eye(4)
    T_map_base[:2, 3] = 2.0, 2.0
    person = item(ObjectState.PERSON, (1.0, 2.0), (1.0, 0.0))
    mask = masks_of(person, T_map_base=T_map_base).keep_out(EXTENT)
    assert value_at(mask, 2.05, 2.05) == value_at(mask, 1.75, 2.0) == 0
    assert value_at(mask, 1.45, 2.0) == 100


def test_speed_falls_with_the_number_of_crossings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(NavigationConfig, 'busy_crossings', 4)
    config = NavigationConfig(enabled=True, busy_speed_percent=40.0)
    masks = NavigationMasks(config)
    for crossing in range(6):
        for step in range(20):
            x_m = -1.0 + 0.1 * step
            y_m = 0.6 if crossing == 0 else 0.1
            person = item(ObjectState.PERSON, (x_m, y_m), (1.0, 0.0))
            masks.update((person,), FAR, (crossing * 30 + step) * NS_PER_S // 10)
        for _ in range(3):
            masks.update((), FAR, 0)
    mask = masks.speed(EXTENT)
    assert value_at(mask, 0.1, 0.6) == 15  # once of four times; the limit is 100 - 15 %
    assert value_at(mask, 0.1, 0.1) == 60
    assert value_at(mask, 0.1, 2.0) == 0
    for _ in range(50):  # who stands still does not cross again
        masks.update((item(ObjectState.PERSON, (0.1, 0.6)),), FAR, 0)
    assert value_at(masks.speed(EXTENT), 0.1, 0.6) == 30


def test_masks_are_published_twice_a_second() -> None:
    masks = NavigationMasks(CONFIG)
    assert sum(masks.update((), FAR, i * NS_PER_S // 10) for i in range(50)) == 10


def test_messages_have_the_place_of_the_cells_and_the_meaning_for_nav2() -> None:
    header = Header(frame_id='map')
    cells = np.array([[0, 100, 0], [0, 0, 50]], np.int8)
    msg = mask_to_msg(Mask(cells, GridExtent((-4, 2), (2, 3), 0.25)), header)
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


def test_what_a_person_closed_is_open_in_nav2_after_the_person_has_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A robot crosses, waits and leaves; only what the outputs publish reaches the costmap."""
    monkeypatch.setattr(NavigationConfig, 'busy_crossings', 1)
    config = NavigationConfig(enabled=True, busy_speed_percent=50.0)
    costmap, outputs = Costmap(), Outputs(config)
    costmap.on_map(outputs.message('grid_map'))
    costmap.cycle(-3.0, 0.0)
    assert not (costmap.cost == LETHAL).any()
    masks = NavigationMasks(config)
    closed, limits = [], []
    for step in range(60):
        robot_m = np.array([-3.0 + 0.1 * min(step, 45), 0.0])
        walking = item(ObjectState.PERSON, (0.0, 2.0 - 0.1 * step), (0.0, -1.0))
        tracks = (walking,) if step < 30 else ()
        T_map_base = np.eye(4)
        T_map_base[:2, 3] = robot_m
        masks.update(tracks, T_map_base, step * NS_PER_S // 10)
        outputs.publish_masks(masks, step)
        outputs.deliver(costmap)
        costmap.cycle(*robot_m.tolist())
        closed.append(int((costmap.cost == LETHAL).sum()))
        limits.append(costmap.limit_percent)
    assert max(closed[:30]) > 500
    assert closed[30:] == [0] * 30
    assert 50.0 in limits  # where the person walked
    assert limits[0] == limits[-1] == 0.0  # before and after leaving that place
    assert costmap.num_errors == 0
    assert outputs.num_of('keep_out_mask/info') == outputs.num_of('speed_mask/info') == 1


def test_an_unchanged_mask_is_not_published_again() -> None:
    outputs, masks = Outputs(CONFIG), NavigationMasks(CONFIG)
    for stamp_ns in range(3):
        masks.update((), FAR, stamp_ns)
        outputs.publish_masks(masks, stamp_ns)
    assert outputs.num_of('keep_out_mask') == outputs.num_of('speed_mask') == 1


def test_a_discarded_scene_opens_what_was_closed() -> None:
    outputs = Outputs(CONFIG)
    outputs.publish_masks(masks_of(item(ObjectState.PERSON, (0.0, 0.0), (1.0, 0.0))), NS_PER_S)
    assert cells_of(outputs.message('keep_out_mask')).max() == 100
    outputs.scene.clear(2 * NS_PER_S)
    assert cells_of(outputs.message('keep_out_mask')).max() == 0


def test_the_changed_cells_are_all_closed_ones_at_first_and_later_the_difference() -> None:
    masks = masks_of(item(ObjectState.PERSON, (0.0, 0.0), (1.0, 0.0)))
    mask = masks.keep_out(EXTENT)
    first = changed_cells(None, mask)
    assert first is not None
    assert (first.cells == 100).sum() == (mask.cells == 100).sum()
    assert changed_cells(mask, mask) is None
