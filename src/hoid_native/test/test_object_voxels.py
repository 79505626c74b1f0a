"""Voxels of objects and what images show of them, against NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_native import (
    merged_voxels,
    missed_voxels,
    pair_scores,
    pixels_on_surface,
    seen_voxels,
    share_on_surface,
    solid_voxels,
    transformed_parts,
    voxel_keys,
    voxels_of,
)
from hoid_native.results import Voxels

VOXEL_M, BITS = 0.025, 10
TURN = np.array([[0.6, -0.8, 0, 0.3], [0.8, 0.6, 0, -0.2], [0, 0, 1, 0.1], [0, 0, 0, 1.0]])


def points(num: int, seed: int = 0) -> NDArray[np.float64]:
    return np.random.default_rng(seed).uniform(-0.4, 0.4, (num, 3))


def plain_keys(points_m: NDArray[np.float64]) -> NDArray[np.int64]:
    cell = np.floor(points_m / VOXEL_M).astype(np.int64) + 512
    is_inside = ((cell >= 0) & (cell < 1024)).all(axis=1)
    return np.where(is_inside, cell @ np.array([1 << 20, 1 << 10, 1]), -1)


def random_voxels(seed: int) -> Voxels:
    rng = np.random.default_rng(seed)
    found = voxels_of(points(2000, seed), VOXEL_M, BITS)
    hits, misses = rng.integers(0, 40, (2, len(found.keys))).astype(np.float32)
    return found._replace(hits=hits, misses=misses)


def test_keys_are_those_of_the_grid_and_minus_one_outside() -> None:
    given = np.concatenate([points(500), [[12.79, 0, 0], [12.81, 0, 0], [0, 0, -12.81]]])
    keys = voxel_keys(given, VOXEL_M, BITS)
    assert np.array_equal(keys, plain_keys(given))
    assert (keys[-3:] < 0).tolist() == [False, True, True]


def test_points_of_a_look_fill_voxels_once() -> None:
    given = np.concatenate([points(3000), [[20.0, 0, 0]]])
    found = voxels_of(given, VOXEL_M, BITS)
    keys, index = np.unique(plain_keys(given[:-1]), return_inverse=True)
    num = np.bincount(index)
    assert np.array_equal(found.keys, keys)
    assert np.array_equal(found.readings, num.astype(np.float32))
    means = np.stack([np.bincount(index, axis) / num for axis in given[:-1].T], 1)
    assert found.means_m == pytest.approx(means)
    assert (found.hits == 1).all()
    assert (found.misses == 0).all()


def test_merging_adds_the_evidence_up_to_a_limit() -> None:
    first, second = random_voxels(1), random_voxels(2)
    merged = merged_voxels(first, second, 60.0, 10**6)
    assert np.array_equal(merged.keys, np.union1d(first.keys, second.keys))
    sums = np.zeros((len(merged.keys), 6))
    for part in (first, second):
        rows = np.searchsorted(merged.keys, part.keys)
        columns = part.readings, part.hits, part.misses
        sums[rows] += np.column_stack([part.means_m * part.readings[:, None], *columns])
    assert merged.means_m == pytest.approx(sums[:, :3] / sums[:, 3:4])
    assert np.array_equal(merged.readings, sums[:, 3])
    scale = np.minimum(1, 60 / np.maximum(sums[:, 4] + sums[:, 5], 1))
    assert merged.hits == pytest.approx(sums[:, 4] * scale, rel=1e-6)
    assert merged.misses == pytest.approx(sums[:, 5] * scale, rel=1e-6)


def test_of_too_many_voxels_those_with_most_hits_stay() -> None:
    first, second = random_voxels(1), random_voxels(2)
    every, some = (merged_voxels(first, second, 60.0, most) for most in (10**6, 700))
    kept = np.sort(np.argsort(every.hits, kind='stable')[-700:])
    for name in Voxels._fields:
        assert np.array_equal(getattr(some, name), getattr(every, name)[kept])


@pytest.mark.parametrize('cell_m', [None, 0.1])
def test_voxels_are_solid_with_hits_enough(cell_m: float | None) -> None:
    voxels = random_voxels(3)
    hits, seen = voxels.hits.astype(float), (voxels.hits + voxels.misses).astype(float)
    if cell_m is not None:
        _, index = np.unique(np.floor(voxels.means_m / cell_m), axis=0, return_inverse=True)
        hits, seen = (np.bincount(index, part)[index] for part in (hits, seen))
    expected = (hits >= 8) & (hits >= 0.4 * seen)
    assert 0 < np.count_nonzero(expected) < len(expected)
    assert np.array_equal(solid_voxels(voxels, 8.0, 0.4, cell_m, BITS), expected)


def test_pixels_and_points_on_a_surface() -> None:
    """The surface has the cells of the points in the left half of an image."""
    depth_m = np.random.default_rng(5).uniform(1, 2, (12, 16)).astype(np.float32)
    depth_m[3, 4] = 0
    points_m = points(depth_m.size, 5)
    is_left = np.tile(np.arange(16) < 8, 12)
    local = points_m @ TURN[:3, :3].T + TURN[:3, 3]
    cells = np.unique(voxel_keys(local[is_left], 0.05, BITS))
    is_on = np.isin(voxel_keys(local, 0.05, BITS), cells)
    assert is_on[is_left].all()
    v, u = np.divmod(np.arange(depth_m.size), 16)
    in_box = (u >= 2) & (u < 16) & (v >= 1) & (v < 9) & (depth_m.ravel() > 0)
    pixels = pixels_on_surface(depth_m, points_m, (2, 1, 99, 9), TURN, cells, 0.05, BITS)
    assert np.array_equal(pixels, np.flatnonzero(is_on & in_box))
    assert share_on_surface(points_m, TURN, cells, 0.05, BITS) == is_on.mean()
    assert share_on_surface(points_m[:0], TURN, cells, 0.05, BITS) == 0


def test_each_part_is_transformed_with_its_own_pose() -> None:
    given = points(5)
    other = np.linalg.inv(TURN)
    out = transformed_parts(given, np.array([2, 2, 5]), np.stack([TURN, np.eye(4), other]))
    assert out[:2] == pytest.approx(given[:2] @ TURN[:3, :3].T + TURN[:3, 3])
    assert out[2:] == pytest.approx(given[2:] @ other[:3, :3].T + other[:3, 3])


def test_what_an_image_shows_of_voxels() -> None:
    """Rows: visible, seen through, occluded, beyond the border, no reading, behind the camera."""
    depth_m = np.full((6, 8), 2.0, np.float32)
    depth_m[5, 5] = 0
    uv = np.array([[1.4, 2.6], [3, 3], [4, 4], [7.6, 1], [5, 5]])
    z = np.array([2.05, 1.5, 2.5, 2.0, 2.0, -1.0])
    solid = np.array([True, True, True, True, True, True])
    seen = seen_voxels(depth_m, np.arange(5), uv, z, solid, np.array([3, 6]), (0.04, 0.006))
    assert seen.is_visible.tolist() == [True, False, False, False, False, False]
    expected = uv.copy()
    expected[3] = np.nan
    assert np.array_equal(seen.uv_px[:5], expected, equal_nan=True)
    assert np.isnan(seen.uv_px[5]).all()
    assert seen.counts.tolist() == [[3, 1, 1], [3, 0, 0]]
    assert seen.boxes_px[0].tolist() == [1.4, 2.6, 1.4, 2.6]
    assert np.isnan(seen.boxes_px[1]).all()


def test_only_solid_voxels_are_counted() -> None:
    depth_m = np.full((6, 8), 2.0, np.float32)
    uv, z = np.array([[1.0, 2], [5, 4], [6, 1]]), np.full(3, 2.0)
    solid = np.array([True, True, False])
    seen = seen_voxels(depth_m, np.arange(3), uv, z, solid, np.array([3]), (0.04, 0.0))
    assert seen.is_visible.all()
    assert seen.counts.tolist() == [[2, 2, 0]]
    assert seen.boxes_px.tolist() == [[1, 2, 5, 4]]


def test_voxels_outside_the_box_and_on_other_things_are_missed() -> None:
    uv = np.array([[1.0, 1], [3, 3], [4.4, 2.6], [2, 2], [np.nan, np.nan]])
    visible = np.array([True, True, True, False, False])
    box, other = np.array([2.0, 2, 5, 5]), np.array([3 * 8 + 4])
    assert missed_voxels(uv, visible, box, other, 8).tolist() == [0, 2]


def scores(is_candidate: Any) -> NDArray[np.float64]:
    """Score two segments of two points with one object, two of whose four voxels are visible."""
    points_m = np.array([[0.0, 0, 0], [5, 0, 0], [0.1, 0.1, 0.1], [0.2, 0, 0]])
    boxes = np.array([[0, 0, 4, 4], [2, 0, 9, 9]], np.int32)
    uv = np.array([[1.0, 1], [3.9, 3], [3, 3], [1, 1]])
    visible = np.array([True, True, False, False])
    ends = np.array([2, 4])
    return pair_scores(
        points_m, ends, boxes, np.eye(4)[None], -np.ones((1, 3)), np.ones((1, 3)), uv, visible,
        np.array([4]), is_candidate,
    )  # fmt: skip


def test_the_score_of_a_pair_is_the_geometric_mean_of_two_shares() -> None:
    assert scores(np.ones((2, 1), np.bool_)).ravel() == pytest.approx([0.5**0.5, 0.5**0.5])
    assert scores(np.array([[False], [True]])).ravel() == pytest.approx([0, 0.5**0.5])
