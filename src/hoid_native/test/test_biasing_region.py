"""The region of a view that biases the pose most, against a reference in NumPy."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_native import Gates, StereoParams, most_biasing_region
from hoid_native.results import BiasingRegion

CAMERA = StereoParams(500.0, 510.0, 320.0, 240.0, 40.0, 0.3, 0.02, 0.4)
GATES = Gates(5.991, 7.815)
GATE_DISPARITY = 3.841
NOISE_SCALE = 0.5
FloatArray = NDArray[np.float64]


def scene(count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return points, their measurements (a third without depth) and weights."""
    rng = np.random.default_rng(count)
    points = rng.uniform([-1.5, -1, 1.5], [1.5, 1, 5], (count, 3))
    measured = pixels(points) + rng.normal(0, 0.3, (count, 3))
    measured[::3, 2] = np.nan
    return points, measured, rng.uniform(0.3, 1, count)


def pixels(points: FloatArray) -> FloatArray:
    x, y, z = points.T
    u = CAMERA.fx_px * x / z + CAMERA.cx_px
    return np.stack([u, CAMERA.fy_px * y / z + CAMERA.cy_px, u - CAMERA.disparity_px_m / z], 1)


def region_of(points: FloatArray, measured: FloatArray, weights: FloatArray) -> BiasingRegion:
    return most_biasing_region(CAMERA, GATES, points, measured, weights, np.eye(4), NOISE_SCALE)


def equations(points: FloatArray, measured: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the (N, 6, 7) normal equations by numeric derivatives; those of outliers are 0."""

    def seen(points: FloatArray) -> FloatArray:
        u, v, right = pixels(points).T
        return np.stack([u, v, u - right], 1)

    error = measured - pixels(points)
    error[:, 2] = error[:, 0] - error[:, 2]
    disparity = measured[:, 0] - measured[:, 2]
    pixel = weights / CAMERA.pixel_noise**2 / NOISE_SCALE
    noise = np.hypot(CAMERA.disparity_noise_px, CAMERA.relative_noise * disparity)
    depth = 1 / noise**2 / NOISE_SCALE
    pixel[pixel * np.square(error[:, :2]).sum(1) > GATES.mono] = 0
    depth[~(depth * error[:, 2] ** 2 <= GATE_DISPARITY)] = 0
    step = 1e-6
    axes = step * np.eye(3)
    moves = [*(np.cross(axis, points) for axis in axes), *axes]
    columns = [(seen(points + move) - seen(points - move)) / (2 * step) for move in moves]
    rows = np.stack([*columns, np.nan_to_num(error)], -1)
    weight = np.stack([pixel, pixel, depth], 1)
    return np.asarray(np.einsum('nra,nr,nrb->nab', rows[..., :6], weight, rows))


def cells(location: FloatArray, members: NDArray[np.int64], level: int) -> list[NDArray[np.int64]]:
    """Return the members of each cell, siblings side by side."""
    if level == 0:
        return [members]
    axis = location[members].var(0).argmax()
    halves = np.split(members[location[members, axis].argsort(kind='stable')], 2)
    return [cell for half in halves for cell in cells(location, half, level - 1)]


def expected(points: FloatArray, measured: FloatArray, weights: FloatArray) -> BiasingRegion:
    count = len(points)
    location = np.stack([*(points[:, :2] / points[:, 2:]).T, np.log(points[:, 2])], 1)
    again = np.arange(-(-count // 16) * 16) % count
    found = cells(location[again], np.arange(len(again)), 4)
    sums = equations(points, measured, weights)
    best = None
    for size in (1, 2, 4):
        for n in range(0, 16, size):
            members = np.concatenate(found[n : n + size])
            rest = sums.sum(0) - sums[members[members < count]].sum(0)
            gain = rest[:, 6] @ np.linalg.solve(rest[:, :6] + 1e-6 * np.eye(6), rest[:, 6])
            if best is None or gain > best.gain:
                mask = np.isin(np.arange(count), again[members])
                best = BiasingRegion(mask, location[mask].min(0), location[mask].max(0), gain)
    assert best is not None
    return best


@pytest.mark.parametrize('count', [320, 333, 40, 17])
def test_it_is_the_region_whose_removal_reduces_the_cost_most(count: int) -> None:
    points, measured, weights = scene(count)
    x, y, _ = points.T
    measured[(x > 0.5) & (y > 0.2), 0] += 0.5
    measured[:3, 1] += 40.0  # outliers in the pixels
    measured[4, 2] -= 9.0  # and in depth
    region, truth = region_of(points, measured, weights), expected(points, measured, weights)
    assert region.mask.tolist() == truth.mask.tolist()
    np.testing.assert_allclose(region.low, truth.low, rtol=1e-12)
    np.testing.assert_allclose(region.high, truth.high, rtol=1e-12)
    assert region.gain == pytest.approx(truth.gain, rel=1e-5)


@pytest.mark.parametrize('count', [0, 1, 3, 15, 16])
def test_few_matches_make_small_regions(count: int) -> None:
    region = region_of(*scene(count))
    assert region.mask.sum() <= max(1, -(-count // 4))
    assert region.gain >= 0


def test_a_point_that_is_not_finite_gives_an_empty_region() -> None:
    points, measured, weights = scene(20)
    points[3, 1] = np.nan
    region = region_of(points, measured, weights)
    assert region.gain == 0
    assert not region.mask.any()


def test_lengths_that_differ_are_refused() -> None:
    points, measured, weights = scene(20)
    with pytest.raises(ValueError, match='measured_px: expected 20 rows, not 19'):
        region_of(points, measured[1:], weights)
