"""Surfaces of detected objects in rendered depth images, the pixels of which are known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_native import object_surfaces
from hoid_native.results import ObjectSurfaces

HEIGHT, WIDTH, FOCAL_PX = 48, 64, 50.0
Area = tuple[int, int, int, int]


def points_of(depth_m: NDArray[np.float32]) -> NDArray[np.float64]:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - 31.5) / FOCAL_PX, (v - 23.5) / FOCAL_PX, np.ones_like(u)], -1)
    return (rays * depth_m[..., None].astype(np.float64)).reshape(-1, 3)


def room(*blocks: tuple[Area, float]) -> NDArray[np.float32]:
    """Return the depth of a wall 4 m ahead, a table 1 m below the camera, and of blocks."""
    v = np.arange(HEIGHT)
    table_m = np.where(v > 24, FOCAL_PX / np.maximum(v - 23.5, 0.1), np.inf)
    depth_m = np.tile(np.minimum(table_m, 4.0)[:, None], (1, WIDTH)).astype(np.float32)
    for (left, top, right, bottom), block_m in blocks:
        depth_m[top:bottom, left:right] = block_m
    return depth_m


def segment(
    depth_m: NDArray[np.float32], boxes: list[Area], people: tuple[int, ...] = (), **known: Any
) -> ObjectSurfaces:
    areas = np.array(boxes, np.int32)
    num = len(boxes)
    sides = (areas[:, 2:] - areas[:, :2]).astype(np.float64)
    is_person = np.isin(np.arange(num), people)
    low, high = np.ones((num, 3)), np.zeros((num, 3))
    for d, (low_m, high_m) in known.get('places', {}).items():
        low[d], high[d] = low_m, high_m
    owner = known.get('owner', np.full(depth_m.size, -1, np.int32))
    return object_surfaces(
        depth_m, points_of(depth_m), 1 / FOCAL_PX, areas, sides.prod(axis=1), is_person,
        known.get('is_support', np.ones(num, np.bool_)),
        known.get('may_be_flat', np.ones(num, np.bool_)),
        np.tile(np.eye(4), (num, 1, 1)), low, high, owner,
    )  # fmt: skip


def parts(found: ObjectSurfaces) -> dict[int, set[int]]:
    """Return the pixels of each segment by its detection."""
    split = np.split(found.pixels, found.pixels_end[:-1])
    pairs = zip(found.detection.tolist(), split, strict=True)
    return {d: set(pixels.tolist()) for d, pixels in pairs}


def pixels_in(left: int, top: int, right: int, bottom: int) -> set[int]:
    v, u = np.mgrid[top:bottom, left:right]
    return set((v * WIDTH + u).ravel().tolist())


def test_the_surface_is_the_block_without_the_table_and_the_wall() -> None:
    block = 24, 18, 36, 38
    depth_m = room((block, 2.5))
    found = segment(depth_m, [(22, 16, 38, 40)])
    assert parts(found) == {0: pixels_in(*block)}
    assert set(found.others.tolist()) == pixels_in(22, 16, 38, 40) - pixels_in(*block)
    inside = points_of(depth_m)[found.pixels]
    assert np.array_equal(found.points_map_m, inside)
    assert found.center_map_m[0] == pytest.approx(np.median(inside, axis=0), abs=0)
    assert np.array_equal(found.low_map_m[0], inside.min(axis=0))
    assert np.array_equal(found.high_map_m[0], inside.max(axis=0))


def test_a_flat_object_keeps_its_surface() -> None:
    """A poster on a wall is on the plane around it, and nothing else is in its box."""
    found = segment(room(), [(10, 4, 24, 16)])
    assert parts(found) == {0: pixels_in(10, 4, 24, 16)}


def test_pixels_without_a_reading_are_in_no_part() -> None:
    block = 24, 10, 36, 20
    depth_m = room((block, 2.5))
    depth_m[12:14, 26:30] = 0
    found = segment(depth_m, [(22, 8, 38, 22)])
    hole = pixels_in(26, 12, 30, 14)
    assert parts(found) == {0: pixels_in(*block) - hole}
    assert not hole & set(found.others.tolist())


@pytest.mark.parametrize('num', [5, 6])
def test_too_few_readings_make_no_segment(num: int) -> None:
    depth_m = np.zeros((HEIGHT, WIDTH), np.float32)
    depth_m[20, 30 : 30 + num] = 2.0
    assert len(segment(depth_m, [(28, 18, 40, 24)]).detection) == (num >= 6)


def test_a_surface_that_two_boxes_claim_belongs_to_the_small_box_that_it_fills() -> None:
    """A cup hides a part of a monitor, whose box contains that of the cup."""
    cup, monitor = (30, 10, 36, 18), (20, 4, 46, 20)
    depth_m = room((monitor, 3.0), (cup, 2.0))
    found = segment(depth_m, [monitor, cup])
    assert parts(found) == {0: pixels_in(*monitor) - pixels_in(*cup), 1: pixels_in(*cup)}


def test_a_person_keeps_the_surface_and_has_no_segment() -> None:
    person, chair = (26, 6, 38, 40), (22, 14, 42, 30)
    depth_m = room((chair, 3.2), (person, 2.0))
    found = segment(depth_m, [chair, person], people=(1,))
    behind = pixels_in(*chair) - pixels_in(*person)
    assert set(parts(found)) == {0}
    assert parts(found)[0] <= behind
    assert len(parts(found)[0]) >= 0.9 * len(behind)


def test_the_surface_of_a_known_object_is_not_that_of_the_one_behind() -> None:
    lamp, couch = (30, 6, 36, 22), (20, 10, 46, 22)
    depth_m = room((couch, 3.0), (lamp, 2.0))
    owner = np.full(depth_m.size, -1, np.int32)
    owner[list(pixels_in(*lamp))] = 1
    found = segment(depth_m, [couch, (26, 6, 36, 22)], owner=owner)
    assert not parts(found)[0] & pixels_in(*lamp)


def test_a_hidden_object_is_what_is_seen_of_its_known_place() -> None:
    """The nearest layer in the box of a chair is a bag before it, which was not detected."""
    chair, bag = (22, 6, 42, 22), (22, 6, 36, 22)
    depth_m = room((chair, 3.0), (bag, 2.0))
    rest = pixels_in(*chair) - pixels_in(*bag)
    assert parts(segment(depth_m, [chair])) == {0: pixels_in(*bag)}
    known = {0: ((-2.0, -2.0, 2.8), (2.0, 2.0, 3.2))}
    assert parts(segment(depth_m, [chair], places=known)) == {0: rest}


def test_an_empty_list_of_detections_has_no_segments() -> None:
    none = np.empty(0, np.bool_)
    found = object_surfaces(
        room(), points_of(room()), 0.02, np.empty((0, 4), np.int32), np.empty(0), none, none, none,
        np.empty((0, 4, 4)), np.empty((0, 3)), np.empty((0, 3)),
        np.full(HEIGHT * WIDTH, -1, np.int32),
    )  # fmt: skip
    assert all(len(part) == 0 for part in found)


def test_a_plane_behind_a_thing_that_is_never_flat_is_no_part_of_it() -> None:
    """The leaves of a plant leave most of its box to the wall, whose readings scatter."""
    noise_m = np.random.default_rng(0).normal(0.0, 0.045, (HEIGHT, WIDTH)).astype(np.float32)
    depth_m = room(((24, 4, 26, 20), 3.75))
    depth_m[depth_m == 4.0] += noise_m[depth_m == 4.0]
    box = 18, 4, 32, 20
    kept = segment(depth_m, [box], may_be_flat=np.array([True]))
    left = segment(depth_m, [box], may_be_flat=np.array([False]))
    leaves = pixels_in(24, 4, 26, 20)
    assert leaves <= parts(left)[0]
    assert len(parts(left)[0] - leaves) < 0.5 * len(parts(kept).get(0, set()) - leaves)


def test_what_a_chair_hides_does_not_get_its_surface() -> None:
    """A box on a table shows what lies on it, a box on a chair what is behind it."""
    chair = 8, 6, 56, 44
    depth_m = room((chair, 2.0))
    owner = np.full((HEIGHT, WIDTH), -1, np.int32)
    owner[6:44, 8:56] = 0
    boxes = [chair, (26, 6, 38, 14)]
    for is_support, is_found in ((True, True), (False, False)):
        found = segment(
            depth_m, boxes, owner=owner.ravel(), is_support=np.array([is_support, True])
        )
        assert (1 in parts(found)) == is_found
