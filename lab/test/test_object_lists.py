"""Lists of what stands in real recordings, and the scores of object maps by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hoid_benchmarks.objects.image_boxes import box_in_image
from hoid_benchmarks.objects.list_scores import FoundBoxes, Verdict, score_list
from hoid_benchmarks.objects.losses import why_missed
from hoid_benchmarks.objects.object_list import ListedObject, listed_recordings, read_list
from hoid_common.coco import COCO
from hoid_common.errors import InputError
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import CameraModel, DynamicObject, Float32Array, ObjectState
from hoid_scene.objects.mapped_object import MapObject

CAMERA = CameraModel(320, 240, 250.0, 250.0, 160.0, 120.0)


def box(x_px: float) -> Float32Array:
    return np.array([x_px, 0.0, x_px + 10.0, 10.0], np.float32)


def listed(name: str, *classes: str, x_px: float, is_unsure: bool = False) -> ListedObject:
    return ListedObject(name, classes, {1: box(x_px), 2: box(x_px)}, is_unsure)


def found(name: str, x_px: float) -> FoundBoxes:
    return FoundBoxes(name, {1: box(x_px), 2: box(x_px)})


@pytest.mark.parametrize('name', listed_recordings())
def test_lists_have_boxes_of_coco_classes_in_three_images(name: str) -> None:
    items = read_list(name)
    assert sum(not item.is_unsure for item in items) >= 2
    assert len({item.name for item in items}) == len(items)
    for item in items:
        assert set(item.classes) <= set(COCO)
        assert len(item.boxes_px) == 3 or item.is_unsure
        for x1, y1, x2, y2 in item.boxes_px.values():
            assert 0 <= x1 < x2 <= 640
            assert 0 <= y1 < y2 <= 480


def test_other_recordings_have_no_list() -> None:
    with pytest.raises(InputError, match='fr2_desk has no list of objects'):
        read_list('fr2_desk')


def test_each_listed_object_has_one_found_object() -> None:
    truth = [listed('left cup', 'cup', 'bowl', x_px=0), listed('book', 'book', x_px=100)]
    maps = [found('cup', 4), found('bowl', 1), found('cup', 100), found('cup', 200)]
    scores = score_list(maps, truth)
    assert scores.verdicts == (Verdict.DOUBLE, Verdict.RIGHT, Verdict.WRONG, Verdict.WRONG)
    assert scores.matches == ('left cup', 'left cup', 'book', '')
    assert scores.missed == ('book',)
    assert scores.num_listed == 2


def test_most_pairs_are_found_not_the_nearest_ones() -> None:
    truth = [listed('one', 'cup', x_px=0), listed('other', 'cup', x_px=5)]
    scores = score_list([found('cup', 2), found('cup', -2)], truth)
    assert scores.verdicts == (Verdict.RIGHT, Verdict.RIGHT)
    assert scores.matches == ('other', 'one')


def test_unsure_objects_are_not_counted() -> None:
    truth = [
        listed('cup', 'cup', x_px=0),
        listed('desk', 'dining table', x_px=100, is_unsure=True),
        listed('cups in a row', 'cup', x_px=0, is_unsure=True),
    ]
    maps = [found('cup', 0), found('cup', 2), found('dining table', 102), found('bed', 100)]
    scores = score_list(maps, truth)
    assert scores.verdicts == (Verdict.RIGHT, Verdict.UNSURE, Verdict.UNSURE, Verdict.WRONG)
    assert scores.missed == ()


def test_images_without_a_pose_do_not_count() -> None:
    truth = [listed('cup', 'cup', x_px=0)]
    scores = score_list([FoundBoxes('cup', {2: box(0)})], truth)
    assert scores.verdicts == (Verdict.RIGHT,)
    assert score_list([FoundBoxes('cup', {})], truth).missed == ('cup',)
    assert score_list([], truth).missed == ('cup',)


def test_a_box_is_cut_at_the_border_of_the_image() -> None:
    def seen(*center_m: float) -> Float32Array:
        T = np.eye(4)
        T[:3, 3] = center_m
        size_m = np.full(3, 0.2)
        item = MapObject(1, 'cup', (('cup', 1.0),), ObjectState.AT_REST, T, size_m, 9, 0, 0, 1.0)
        return box_in_image(item, T_BODY_OPTICAL, CAMERA)

    half_px = 0.1 / 0.9 * 250  # the camera looks along x; the near side is the largest
    middle = [160 - half_px, 120 - half_px, 160 + half_px, 120 + half_px]
    np.testing.assert_allclose(seen(1.0, 0.0, 0.0), middle, atol=1e-4)
    left, _, right, _ = seen(1.0, 0.6, 0.0)
    assert left < 4  # a point of the box is nearer to the border than this
    assert right == pytest.approx(160 - 0.5 / 1.1 * 250)
    assert not seen(-1.0, 0.0, 0.0).any()


def mapped(class_name: str, state: ObjectState) -> MapObject:
    return MapObject(
        1, class_name, ((class_name, 1.5),), state, np.eye(4), np.ones(3), 5, 0, 0, 0.9
    )


def test_each_missed_object_has_the_step_that_lost_it() -> None:
    cup = listed('cup', 'cup', x_px=0)
    edges = tuple(box(0).tolist())
    seen = DynamicObject('cup', edges, 0.5, -1, ObjectState.AT_REST)

    def why(
        objects: list[MapObject],
        at_px: int,
        *boxes: DynamicObject,
        poses: tuple[int, ...] = (1,),
    ) -> str:
        found_boxes = [found(item.class_name, at_px) for item in objects]
        verdicts = dict.fromkeys(cup.boxes_px, boxes)
        return why_missed(cup, objects, found_boxes, verdicts, poses)

    tentative = mapped('cup', ObjectState.TENTATIVE)
    assert why([], 0, seen, poses=()) == 'no pose in the main map'
    assert why([], 0) == 'never detected'
    assert why([], 0, replace(seen, state=ObjectState.HANDLED)) == 'detected, but handled'
    assert why([], 0, seen) == 'detected, but no surface'
    assert why([tentative], 0, seen) == 'not sure: 5 detections of 0.30'
    assert why([mapped('bowl', ObjectState.AT_REST)], 0, seen) == 'called bowl in 5 looks'
    assert why([tentative], 8, seen).startswith('detected, but IoU 0.')
    assert why([mapped('cup', ObjectState.GONE)], 0, seen) == 'gone'
