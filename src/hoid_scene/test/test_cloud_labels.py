"""Points of a cloud get the classes of the objects that they are on."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common.errors import ConfigError
from hoid_common.values import Float32Array
from hoid_scene.config.object_config import ObjectMapConfig
from hoid_scene.objects.object_map import ObjectMap

from .object_world import Box, ObjectWorld, keyframes

TABLE = Box('dining table', (1.6, -0.8, -1.2), (2.6, 0.8, -0.45))
CUP = Box('cup', (1.9, 0.3, -0.45), (2.0, 0.4, -0.3))
BOOK = Box('book', (1.8, -0.5, -0.45), (2.1, -0.2, -0.4))


def front_of(box: Box) -> Float32Array:
    """Return points on the side of a box that faces the camera."""
    (x, low_y, low_z), (_, high_y, high_z) = box.low_m, box.high_m
    y, z = np.mgrid[low_y + 0.02 : high_y - 0.02 : 9j, low_z + 0.01 : high_z - 0.01 : 9j]
    points_m = np.stack([np.full(y.shape, x), y, z], axis=-1).reshape(-1, 3)
    return points_m.astype(np.float32)


def share_of(object_map: ObjectMap, points_m: Float32Array, class_name: str) -> float:
    """Return the share of points (N, 3) with the label of a class; '': without an object."""
    labels, names = object_map.label(points_m)
    number = names.index(class_name) + 1 if class_name else 0
    return float(np.mean(labels == number))


def test_points_have_the_class_of_the_object_that_they_are_on() -> None:
    world = ObjectWorld()
    assert share_of(world.map, front_of(CUP), '') == 1
    world.look(TABLE, CUP, BOOK, times=6)
    assert share_of(world.map, front_of(CUP), 'cup') > 0.95
    assert share_of(world.map, front_of(BOOK), 'book') > 0.95
    table_m = front_of(TABLE)
    upper_m = table_m[table_m[:, 2] > -0.7]  # the rest of the front has no object yet
    assert share_of(world.map, upper_m, 'dining table') > 0.95
    wall_m = np.array([[5.0, 0.0, 0.0], [5.0, 1.0, 1.0], [40.0, 0.0, 0.0]], np.float32)
    assert share_of(world.map, wall_m, '') == 1


def test_the_place_of_an_object_that_has_gone_has_no_label_and_the_others_keep_theirs() -> None:
    world = ObjectWorld()
    world.look(CUP, BOOK, times=4)
    before = world.map.label(front_of(BOOK))
    world.look(BOOK, times=8)
    after = world.map.label(front_of(BOOK))
    assert share_of(world.map, front_of(CUP), '') == 1
    np.testing.assert_array_equal(after.labels, before.labels)
    assert after.class_names == before.class_names == ('cup', 'book')


def test_labels_move_with_the_keyframes() -> None:
    world = ObjectWorld()
    world.look(CUP, times=4)
    T_map_keyframe = np.eye(4)
    T_map_keyframe[0, 3] = 0.5
    world.map.correct(keyframes(T_map_keyframe, version=2))
    moved_m = front_of(CUP) + np.array([0.5, 0, 0], np.float32)
    assert share_of(world.map, moved_m, 'cup') > 0.7
    assert share_of(world.map, front_of(CUP), '') == 1


def test_labels_without_an_object_map_are_refused() -> None:
    with pytest.raises(ConfigError, match=r'label_cloud needs object_map\.enabled'):
        ObjectMapConfig(label_cloud=True)
