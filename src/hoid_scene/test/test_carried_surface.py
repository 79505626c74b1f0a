"""Voxels of the dense map where an object is carried away, and where it is put down."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import Float32Array, ObjectState
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.config.object_config import ObjectTrackerConfig
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.scene_scheduler import SceneRequest

from .object_world import CAMERA, Box, keyframes, rendered

TABLE = Box('', (2.0, -1.0, -0.6), (3.0, 1.0, -0.5))
PERSON = Box('person', (2.2, -1.0, -1.2), (2.5, -0.5, 0.4), ObjectState.PERSON)
RATE_HZ = 10


def suitcase(left_m: float) -> Box:
    """Return a suitcase on the table that the filter calls handled; y of its right side."""
    return Box('suitcase', (2.1, left_m, -0.49), (2.3, left_m + 0.3, -0.1), ObjectState.HANDLED)


class Scene:
    """A scene mapper that fuses each image after the tracks have been updated with it."""

    def __init__(self, *, has_tracks: bool = True) -> None:
        self.mapper = SceneMapper(CAMERA, DenseConfig(), ObjectTrackerConfig())
        self.has_tracks, self.stamp_ns = has_tracks, 0

    def show(self, *boxes: Box) -> None:
        depth_m, seen = rendered(boxes, T_BODY_OPTICAL)
        request = SceneRequest(self.stamp_ns, T_BODY_OPTICAL, 0, keyframes(np.eye(4)))
        if self.has_tracks:
            self.mapper.track_objects(request, depth_m, tuple(seen))
        image_bgr = np.zeros((*depth_m.shape, 3), np.uint8)
        self.mapper.fuse(request, depth_m, image_bgr, tuple(seen))
        self.stamp_ns += 10**9 // RATE_HZ

    def points_at(self, box: Box) -> Float32Array:
        """Return the points of the dense map on or in a box, enlarged by 3 cm above the table."""
        points_m = self.mapper.cloud().points_m
        low, high = np.array(box.low_m) - (0.03, 0.03, -0.04), np.array(box.high_m) + 0.03
        return points_m[((points_m > low) & (points_m < high)).all(axis=1)]


def carry(scene: Scene) -> None:
    """Carry the suitcase 1 m along the table within a second."""
    for step in range(RATE_HZ):
        scene.show(TABLE, PERSON, suitcase(-0.6 + 0.1 * step))


@pytest.mark.slow
def test_an_object_that_is_called_handled_is_fused_where_it_rests() -> None:
    scene = Scene()
    carry(scene)
    assert len(scene.points_at(suitcase(-0.2))) == 0
    for _ in range(2 * RATE_HZ):
        scene.show(TABLE, PERSON, suitcase(0.4))
    front = scene.points_at(suitcase(0.4))
    # The front, 30 x 39 cm, has 12 x 16 voxels.
    assert len(front) > 150
    assert np.abs(front[:, 0] - 2.1).max() < 0.03 + 0.2
    assert len(scene.points_at(suitcase(-0.2))) == 0


@pytest.mark.slow
def test_without_tracks_it_is_not_fused() -> None:
    scene = Scene(has_tracks=False)
    carry(scene)
    for _ in range(2 * RATE_HZ):
        scene.show(TABLE, PERSON, suitcase(0.4))
    assert len(scene.points_at(suitcase(0.4))) == 0


@pytest.mark.slow
def test_a_thing_that_is_carried_past_an_object_at_rest_is_not_fused() -> None:
    """A second suitcase passes 0.6 m before the first one, so that its box contains the place."""
    scene = Scene()
    resting = suitcase(0.4)._replace(reason=ObjectState.AT_REST)
    for _ in range(RATE_HZ):
        scene.show(TABLE, resting)
    for step in range(RATE_HZ):
        left = 0.1 + 0.03 * step
        passing = Box('suitcase', (1.4, left, -0.45), (1.5, left + 0.3, 0.1), ObjectState.HANDLED)
        scene.show(TABLE, PERSON, resting, passing)
    way = Box('', (1.4, 0.1, -0.45), (1.5, 0.7, 0.1))
    assert len(scene.points_at(way)) == 0


@pytest.mark.slow
def test_people_are_not_fused_beside_an_object_at_rest() -> None:
    scene = Scene()
    for _ in range(3 * RATE_HZ):
        scene.show(TABLE, PERSON, suitcase(-0.45))
    body = Box('', (2.2, -1.0, -0.5), (2.5, -0.52, 0.4))
    assert len(scene.points_at(body)) == 0
