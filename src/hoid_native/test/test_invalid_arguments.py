"""Invalid arguments are refused, instead of reading beyond an array's end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hoid_native import (
    Candidates,
    Gates,
    MatchThreshold,
    QueryConstraints,
    StereoParams,
    adjust_bundle,
    box_center_depths_m,
    classify_boxes,
    fast_corners,
    match_along_segments,
    match_by_projection,
    object_surfaces,
    orb_descriptors,
    person_depths_m,
    pixels_on_surface,
    seen_voxels,
    segment_objects,
    solid_voxels,
    transformed_parts,
    voxels_of,
)

DEPTH_M = np.ones((20, 30), np.float32)
IMAGE = np.zeros((60, 80), np.uint8)
ONE_STEP = np.ones((1, 2), np.float32)
BOX = np.array([[2.0, 2.0, 9.0, 9.0]])
OBJECT = np.array([1.0]), np.array([0.5]), np.array([True])


def test_another_dtype_or_shape_is_a_type_error() -> None:
    wrong: Any
    for wrong in (IMAGE.astype(np.int16), IMAGE.ravel(), IMAGE.astype(np.float64)):
        with pytest.raises(TypeError, match='fast_corners'):
            fast_corners([wrong], ONE_STEP, 7, 3)
    with pytest.raises(TypeError, match='box_center_depths_m'):
        box_center_depths_m(DEPTH_M.astype(np.uint16), BOX, 3)
    with pytest.raises(TypeError, match='box_center_depths_m'):
        box_center_depths_m(DEPTH_M, np.ones((2, 3)), 3)


def test_strided_and_read_only_arrays_are_accepted() -> None:
    depth_m = np.random.default_rng(0).uniform(1, 2, (40, 60)).astype(np.float32)
    view = depth_m[::2, 1::2]
    view.flags.writeable = False
    expected = box_center_depths_m(view.copy(), BOX, 5)
    for given in (view, np.asfortranarray(view)):
        np.testing.assert_array_equal(box_center_depths_m(given, BOX, 5), expected)
    whole = np.round(BOX).astype(np.int64)
    np.testing.assert_array_equal(box_center_depths_m(view, whole, 5), expected)


def classify(pixel: int) -> object:
    roles = np.ones(1, np.uint8)
    return classify_boxes(DEPTH_M, np.array([0, pixel]), BOX, roles, 3, 0.4, 0.2, 1.0)


def segment(*area: int) -> object:
    return segment_objects(DEPTH_M, np.array([area], np.int32), *OBJECT)


def search(octave: int, max_octave: int, num_octaves: int = 1, num_measured: int = 1) -> object:
    descriptors = np.zeros((1, 32), np.uint8)
    queries = QueryConstraints(
        np.zeros(num_octaves, np.int8), np.array([max_octave], np.int8), descriptors
    )
    features = Candidates(
        np.zeros((num_measured, 3), np.float32), np.array([octave], np.uint8), descriptors
    )
    segments = np.array([[0.0, 0.0, 9.0, 9.0]])
    return match_along_segments(segments, np.ones(4), queries, features, MatchThreshold(60, 1.0))


def adjust(camera: int, point: int, num_free: int = 0) -> object:
    return adjust_bundle(
        StereoParams(500.0, 500.0, 320.0, 240.0, 40.0, 0.3, 0.02), Gates(6.0, 8.0),
        np.eye(4)[None], num_free, np.ones((2, 3)), np.array([0, camera]), np.array([0, point]),
        np.ones((2, 3)), np.ones(2), 1, 1,
    )  # fmt: skip


def describe(angle_deg: float) -> object:
    at = np.array([30], np.int32)
    return orb_descriptors(IMAGE, at, at, np.array([angle_deg], np.float32))


def find_surfaces(right: int, owner: int) -> object:
    corner, box = np.zeros((1, 3)), np.array([[0, 0, right, 5]], np.int32)
    no, yes = np.zeros(1, np.bool_), np.ones(1, np.bool_)
    return object_surfaces(
        DEPTH_M, np.zeros((600, 3)), 0.1, box, np.ones(1), no, yes, yes,
        np.eye(4)[None], corner, corner, np.full(600, owner, np.int32),
    )  # fmt: skip


def find_pixels(num_points: int) -> object:
    return pixels_on_surface(
        DEPTH_M, np.zeros((num_points, 3)), (0, 0, 9, 9), np.eye(4), np.zeros(1, np.int64), 0.1, 9
    )


def see(row: int, end: int) -> object:
    flags, ends = np.ones(2, np.bool_), np.array([end])
    rows, uv = np.array([row]), np.ones((1, 2))
    return seen_voxels(DEPTH_M, rows, uv, np.ones(2), flags, ends, (0.1, 0.0))


@pytest.mark.parametrize(
    ('call', 'reason'),
    [
        (lambda: find_surfaces(31, -1), 'boxes_px: a box is not within the image of 30 x 20 px'),
        (lambda: find_surfaces(30, 1), 'owner: 1 to 1 is not within -1 to 0'),
        (lambda: find_pixels(599), 'points_map_m: expected 600 rows, not 599'),
        (lambda: see(2, 2), 'ahead: 2 to 2 is not within 0 to 1'),
        (lambda: see(0, 3), 'ends: the last one must be 2'),
        (lambda: transformed_parts(np.ones((4, 3)), np.array([3, 2, 4]), np.ones((3, 4, 4))),
         'ends: must be ascending'),
        (lambda: voxels_of(np.ones((1, 3)), 0.0, 10), 'voxel_m: must be positive'),
        (lambda: voxels_of(np.ones((1, 3)), 0.1, 21), 'bits: must be within 1 to 20'),
        (lambda: solid_voxels(voxels_of(np.ones((1, 3)), 0.1, 9)._replace(hits=np.ones(
            2, np.float32)), 1.0, 0.4, None, 9), 'hits: expected 1 rows, not 2'),
        (lambda: classify(-1), 'pixels: -1 to 0 is not within 0 to 599'),
        (lambda: classify(600), 'pixels: 0 to 600 is not within 0 to 599'),
        (lambda: segment(0, 0, 31, 5),
         'areas_xyxy_px: a box is not within the image of 30 x 20 px'),
        (lambda: segment(0, -1, 9, 5), 'areas'),
        (lambda: segment(0, 0, 30, 21), 'areas'),
        (lambda: search(4, 3), 'octave: 4 to 4 is not within 0 to 3'),
        (lambda: search(1, 4), 'max_octave'),
        (lambda: search(1, -1), 'max_octave'),
        (lambda: adjust(1, 0), 'camera: 0 to 1 is not within 0 to 0'),
        (lambda: adjust(-1, 0), 'camera'),
        (lambda: adjust(0, 2), 'point'),
        (lambda: adjust(0, 0, 2), 'num_free'),
        (lambda: describe(np.nan), 'angle_deg: not all are finite'),
        (lambda: box_center_depths_m(DEPTH_M, BOX * np.inf, 3), 'boxes_xyxy_px'),
        (lambda: box_center_depths_m(DEPTH_M, BOX, 0), 'side_px'),
        (lambda: box_center_depths_m(DEPTH_M[:0], BOX, 3), 'empty'),
        (lambda: person_depths_m(DEPTH_M, BOX * np.nan, np.ones(1)), 'boxes_xyxy_px'),
        (lambda: person_depths_m(DEPTH_M, BOX, np.ones(2)), 'known_m: expected 1 rows, not 2'),
        (lambda: fast_corners([IMAGE], ONE_STEP, 255, 3), 'threshold'),
        (lambda: search(0, 0, num_measured=2), 'measurement_px: expected 1 rows, not 2'),
        (lambda: search(0, 0, num_octaves=0), 'min_octave: expected 1 rows, not 0'),
    ],
)  # fmt: skip
def test_indices_beyond_an_array_are_refused(call: Callable[[], object], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        call()


def test_valid_values_pass() -> None:
    for call in (
        classify(599),
        segment(0, 0, 30, 20),
        search(3, 3),
        adjust(0, 1, 1),
        find_surfaces(30, 0),
        find_pixels(600),
        see(1, 2),
    ):
        assert call is not None


@pytest.mark.parametrize('far', [np.nan, np.inf, -np.inf, 1e30, -3e9])
def test_features_from_a_distortion_that_diverges_match_nothing(far: float) -> None:
    """Such positions cannot be converted to the integer index of a grid cell."""
    measured = np.array([[far, 10, 0], [10, 10, 0], [10, far, 0]], np.float32)
    descriptors = np.zeros((3, 32), np.uint8)
    octave = np.zeros(3, np.int8)
    queries = QueryConstraints(octave, octave, descriptors)
    features = Candidates(measured, octave.astype(np.uint8), descriptors)
    projection_px = np.array([[10.0, far, 10], [10, 10, far], [np.nan] * 3])
    pairs = match_by_projection(
        projection_px, np.full(3, 5.0), queries, features, MatchThreshold(60, 1.0)
    )
    assert (pairs.q.tolist(), pairs.k.tolist()) == ([0], [1])
    only_far = Candidates(measured[::2], octave[::2].astype(np.uint8), descriptors[::2])
    none = match_by_projection(
        projection_px, np.full(3, 5.0), queries, only_far, MatchThreshold(60, 1.0)
    )
    assert len(none.q) == 0


def test_boxes_far_beyond_the_image_repeat_its_edge() -> None:
    depth_m = DEPTH_M.copy()
    depth_m[0, 0], depth_m[-1, -1] = 2.0, 3.0
    far = np.array([[-1e300, -1e300, -1e299, -1e299], [1e299, 1e299, 1e300, 1e300]])
    assert box_center_depths_m(depth_m, far, 3).tolist() == [2.0, 3.0]


def test_too_little_memory_raises_a_memory_error() -> None:
    """The dense system of 200,000 cameras would take 11 TB, and raises a MemoryError."""
    poses = np.broadcast_to(np.eye(4), (200_000, 4, 4))
    none = np.zeros(0, np.int64)
    with pytest.raises(MemoryError):
        adjust_bundle(
            StereoParams(500.0, 500.0, 320.0, 240.0, 40.0, 0.3, 0.02), Gates(6.0, 8.0),
            poses, 200_000, np.ones((0, 3)), none, none, np.ones((0, 3)), np.ones(0), 1, 1,
        )  # fmt: skip
