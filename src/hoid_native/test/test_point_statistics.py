"""Viewing direction, scale range and descriptor of points, against NumPy."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_native import point_statistics

SCALE = 1.2 ** np.arange(4)
KEYFRAMES, FEATURES, POINTS = 20, 30, 120


def world(seed: int = 0) -> dict[str, Any]:
    """Keyframes that look at points in front of them, each observed one to thirteen times."""
    rng = np.random.default_rng(seed)
    T_map_camera = np.tile(np.eye(4), (KEYFRAMES, 1, 1))
    T_map_camera[:, :3, 3] = rng.uniform(-1, 1, (KEYFRAMES, 3))
    pairs = [(i, j) for j in range(POINTS) for i in chosen(rng, KEYFRAMES)]
    i, j = np.array(pairs).T
    return {
        'T_map_camera': T_map_camera,
        'keyframe_uid': 100 + rng.permutation(KEYFRAMES),
        'octave': rng.integers(0, 6, (KEYFRAMES, FEATURES)).astype(np.uint8),
        'descriptors': rng.integers(0, 4, (KEYFRAMES, FEATURES, 32)).astype(np.uint8),
        'position_m': rng.uniform([-2, -2, 3], [2, 2, 6], (POINTS, 3)),
        'reference_uid': 100 + rng.integers(0, KEYFRAMES + 5, POINTS),
        'i': i,
        'k': rng.integers(0, FEATURES, len(i)),
        'j': j,
        'octave_scale': SCALE,
    }


def chosen(rng: np.random.Generator, end: int) -> NDArray[np.int64]:
    return np.sort(rng.choice(end, int(rng.integers(1, 14)), replace=False))


def test_the_statistics_are_those_of_numpy() -> None:
    given = world()
    found = point_statistics(**given)
    i, k, j = given['i'], given['k'], given['j']
    assert found.rows.tolist() == list(range(POINTS))
    num_lost_references = 0
    for row in range(POINTS):
        seen = np.flatnonzero(j == row)
        ray = given['position_m'][row] - given['T_map_camera'][i[seen], :3, 3]
        distance_m = np.linalg.norm(ray, axis=1)
        mean = (ray / distance_m[:, None]).sum(axis=0)
        np.testing.assert_allclose(
            found.view_direction[row], mean / np.linalg.norm(mean), atol=1e-6
        )
        is_reference = given['keyframe_uid'][i[seen]] == given['reference_uid'][row]
        num_lost_references += not is_reference.any()
        n = int(is_reference.argmax())  # the first observation if no one is the reference
        assert found.reference[row] == i[seen[n]]
        octave = min(given['octave'][i[seen[n]], k[seen[n]]], len(SCALE) - 1)
        np.testing.assert_allclose(
            found.max_distance_m[row], distance_m[n] * SCALE[octave], rtol=1e-6
        )
    assert num_lost_references > 5


def test_the_median_distance_to_the_last_eight_descriptors_is_smallest() -> None:
    given = world(1)
    found = point_statistics(**given)
    for row in range(POINTS):
        seen = np.flatnonzero(given['j'] == row)
        last = given['descriptors'][given['i'][seen], given['k'][seen]][-8:]
        apart = np.bitwise_count(last[:, None] ^ last).sum(-1)
        best = int(np.median(apart, axis=1).argmin())
        expected = last[best] if len(last) > 2 else last[-1]
        np.testing.assert_array_equal(found.descriptors[row], expected)


def test_no_observations_have_no_points() -> None:
    empty = np.empty(0, np.int64)
    found = point_statistics(**(world() | {'i': empty, 'k': empty, 'j': empty}))
    assert found.rows.shape == (0,)
    assert found.descriptors.shape == (0, 32)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'j': np.array([1, 0])}, 'j: must ascend'),
        ({'j': np.array([0, POINTS])}, 'j: 0 to 120 is not within 0 to 119'),
        ({'i': np.array([0, KEYFRAMES])}, 'i: 0 to 20 is not within 0 to 19'),
        ({'k': np.array([0, FEATURES])}, 'k: 0 to 30 is not within 0 to 29'),
        ({'keyframe_uid': np.arange(3)}, 'keyframe_uid: expected 20 rows'),
        ({'reference_uid': np.arange(3)}, 'reference_uid: expected 120 rows'),
        ({'octave_scale': np.empty(0)}, 'octave_scale: must not be empty'),
    ],
)
def test_rows_out_of_range_are_refused(change: dict[str, Any], message: str) -> None:
    pair = {name: np.zeros(2, np.int64) for name in 'ikj'}
    with pytest.raises(ValueError, match=message):
        point_statistics(**(world() | pair | change))
