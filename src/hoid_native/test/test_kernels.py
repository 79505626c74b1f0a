"""Feature and matching kernels, against OpenCV and reference implementations."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hoid_native import (
    Candidates,
    MatchThreshold,
    QueryConstraints,
    fast_corners,
    match_by_projection,
    orb_descriptors,
    orientations_deg,
    subpixel_offsets_px,
)
from hoid_native.results import Corners

ByteArray = NDArray[np.uint8]


def textured(seed: int, height: int = 97, width: int = 131) -> ByteArray:
    noise = np.random.default_rng(seed).integers(0, 256, (height, width)).astype(np.uint8)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 1.2), np.uint8)


def corners_of(image: ByteArray, threshold: int, border_px: int) -> Corners:
    return fast_corners([image], np.ones((1, 2), np.float32), threshold, border_px)


def opencv_corners(image: ByteArray, threshold: int, border: int) -> dict[tuple[int, int], int]:
    found = cv2.FastFeatureDetector.create(threshold, True).detect(image)
    height, width = image.shape
    return {
        (int(p.pt[0]), int(p.pt[1])): int(p.response)
        for p in found
        if border <= p.pt[0] < width - border and border <= p.pt[1] < height - border
    }


@pytest.mark.parametrize('threshold', [1, 7, 20, 60])
@pytest.mark.parametrize('size', [(97, 131), (64, 40), (120, 321)])
def test_corners_and_scores_equal_opencvs(threshold: int, size: tuple[int, int]) -> None:
    image = textured(threshold, *size)
    corners = corners_of(image, threshold, 3)
    mine = dict(zip(map(tuple, corners.xy_px.tolist()), corners.score.tolist(), strict=True))
    assert mine == opencv_corners(image, threshold, 3)
    assert mine or threshold > 20


def test_a_strided_view_equals_its_copy() -> None:
    image = textured(5)
    view = image[5:90, 7:120]
    corners = corners_of(view, 7, 3)
    copied = corners_of(view.copy(), 7, 3)
    assert corners.xy_px.tolist() == copied.xy_px.tolist()


def test_corners_of_all_levels_have_a_level_0_position() -> None:
    levels = [textured(1, 120, 160), textured(2, 20, 20), textured(3, 60, 81)]
    steps_px = np.array([[1, 1], [8, 6], [160 / 81, 2]], np.float32)
    found = fast_corners(levels, steps_px, 20, 5)
    each = [corners_of(level, 20, 5) for level in levels]
    assert found.octave.tolist() == [0] * len(each[0].score) + [2] * len(each[2].score)
    assert found.xy_px.tolist() == [xy for one in each for xy in one.xy_px.tolist()]
    assert found.score.tolist() == [score for one in each for score in one.score.tolist()]
    expected_px = (found.xy_px + 0.5) * steps_px[found.octave] - 0.5
    np.testing.assert_array_equal(found.uv_px, expected_px)
    column, row = np.rint(found.uv_px).astype(int).T
    assert found.pixel.tolist() == (row * 160 + column).tolist()
    none = fast_corners([], steps_px[:0], 20, 5)
    assert (none.xy_px.shape, none.uv_px.shape, len(none.pixel)) == ((0, 2), (0, 2), 0)
    with pytest.raises(ValueError, match='levels'):
        fast_corners(levels[1:2] * 257, steps_px, 20, 5)
    with pytest.raises(ValueError, match='steps_px'):
        fast_corners(levels, steps_px[:2], 20, 5)


def test_too_small_an_image_has_no_corners() -> None:
    assert len(corners_of(textured(1, 20, 20), 7, 3).score) == 0


def test_white_and_black_images_saturate_without_corners() -> None:
    for value in (0, 255):
        assert len(corners_of(np.full((80, 80), value, np.uint8), 7, 3).score) == 0


def spots(shift_px: tuple[float, float]) -> ByteArray:
    """Return dark spots on a bright ground, 20 px apart, moved by (x, y)."""
    y, x = np.mgrid[:120, :160].astype(float)
    apart = np.hypot((x - shift_px[0] + 10) % 20 - 10, (y - shift_px[1] + 10) % 20 - 10)
    return np.asarray(np.rint(220 - 180 * np.exp(-0.5 * (apart / 1.5) ** 2)), np.uint8)


@pytest.mark.parametrize('shift_px', [(0.0, 0.0), (0.3, 0.0), (-0.2, 0.4), (0.4, -0.4)])
def test_subpixel_offsets_locate_a_spot(shift_px: tuple[float, float]) -> None:
    image = spots(shift_px)
    xy_px = corners_of(image, 7, 10).xy_px
    peak_px = xy_px + subpixel_offsets_px(image, *xy_px.T.copy())
    error_px = (peak_px - shift_px + 10) % 20 - 10
    assert len(error_px) == 7 * 5
    assert np.abs(error_px).max() < 0.1


_RING = [(0, -3), (1, -3), (2, -2), (3, -1), (3, 0), (3, 1), (2, 2), (1, 3)]
_CIRCLE = _RING + [(-x, -y) for x, y in _RING]


def signed_score(image: ByteArray, x: int, y: int) -> int:
    gain = [int(image[y + dy, x + dx]) - int(image[y, x]) for dx, dy in _CIRCLE]
    arcs = [[gain[(first + n) % 16] for n in range(9)] for first in range(16)]
    return max(max(min(arc), -max(arc)) for arc in arcs)


def test_subpixel_offsets_equal_the_peak_of_the_fitted_quadratic() -> None:
    image = textured(4)
    corners = corners_of(image, 7, 4)
    x, y = corners.xy_px.T.copy()
    found = subpixel_offsets_px(image, x, y)
    around = [(dx, dy) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    design = np.array([[1, dx, dy, dx * dx / 2, dx * dy, dy * dy / 2] for dx, dy in around])
    num_peaks = 0
    for n, (u, v) in enumerate(zip(x.tolist(), y.tolist(), strict=True)):
        scores = [signed_score(image, u + dx, v + dy) for dx, dy in around]
        assert scores[4] == corners.score[n] + 1
        _, b, c, d, e, f = np.linalg.lstsq(design, np.array(scores, float))[0]
        curvature = np.array([[d, e], [e, f]])
        if np.linalg.eigvalsh(curvature).max() < -1e-9:
            expected = np.clip(-np.linalg.solve(curvature, [b, c]), -0.5, 0.5)
            num_peaks += 1
        else:
            expected = np.zeros(2)
        assert found[n] == pytest.approx(expected, abs=1e-4)
    assert num_peaks > 0.5 * len(x) > 20


def test_subpixel_offsets_near_the_edge_are_refused() -> None:
    with pytest.raises(ValueError, match='4 px'):
        subpixel_offsets_px(textured(1), np.array([3], np.int32), np.array([50], np.int32))


@pytest.mark.parametrize('angle_deg', [0, 30, 90, 135, 200, 359])
def test_orientation_points_along_the_gradient(angle_deg: int) -> None:
    v, u = np.mgrid[-40:41, -40:41]
    ramp = np.cos(np.radians(angle_deg)) * u + np.sin(np.radians(angle_deg)) * v
    image = np.clip(np.rint(128 + 4 * ramp), 0, 255).astype(np.uint8)
    (found,) = orientations_deg(image, np.array([40], np.int32), np.array([40], np.int32))
    assert (found - angle_deg + 180) % 360 - 180 == pytest.approx(0, abs=0.5)
    assert 0 <= found < 360


def test_orientation_equals_opencvs() -> None:
    image = textured(3, 200, 200)
    points = cv2.ORB.create(nlevels=1, nfeatures=50, edgeThreshold=31).detect(image)
    x, y = np.rint(cv2.KeyPoint.convert(points)).astype(np.int32).T
    difference = orientations_deg(image, x, y) - [p.angle for p in points]
    assert np.abs((difference + 180) % 360 - 180).max() < 0.1


def test_orientation_near_the_edge_is_refused() -> None:
    with pytest.raises(ValueError, match='15 px'):
        orientations_deg(textured(1), np.array([14], np.int32), np.array([50], np.int32))


@pytest.mark.parametrize('seed', [1, 2])
def test_descriptors_equal_opencvs(seed: int) -> None:
    image = textured(seed, 240, 320)
    rng = np.random.default_rng(seed)
    n = 2000
    x, y = rng.integers(19, [320 - 19, 240 - 19], (n, 2), dtype=np.int32).T
    angle_deg = rng.uniform(0, 360, n).astype(np.float32)
    angle_deg[:4] = 0, 90, 180, 270
    points = [
        cv2.KeyPoint(u, v, 31, angle, 1.0, 0)
        for u, v, angle in zip(x.tolist(), y.tolist(), angle_deg.tolist(), strict=True)
    ]
    _, expected = cv2.ORB.create(nlevels=1, edgeThreshold=19).compute(image, points)
    kernel = cv2.getGaussianKernel(7, 2.0)
    smooth = np.asarray(cv2.sepFilter2D(image, cv2.CV_8U, kernel, kernel), np.uint8)
    assert np.array_equal(orb_descriptors(smooth, x, y, angle_deg), expected)


def test_descriptors_near_the_edge_are_refused() -> None:
    column, row, angle_deg = (np.array([n], np.int32) for n in (50, 18, 0))
    with pytest.raises(ValueError, match='19 px'):
        orb_descriptors(textured(1), column, row, angle_deg.astype(np.float32))


def brute_force(
    proj: NDArray[np.float64],
    radius: NDArray[np.float64],
    low: NDArray[np.int8],
    high: NDArray[np.int8],
    wanted: ByteArray,
    measured: NDArray[np.float32],
    octave: ByteArray,
    known: ByteArray,
    free: NDArray[np.bool_],
    most: int,
    ratio: float,
) -> set[tuple[int, int]]:
    """Return the pairs by brute force."""
    wins: dict[int, list[tuple[int, int]]] = {}
    for q in range(len(radius)):
        near = []
        for k in range(len(octave)):
            inside = (np.abs(measured[k, :2] - proj[:2, q]) < radius[q]).all()
            apart = abs(measured[k, 2] - proj[2, q])
            if inside and low[q] <= octave[k] <= high[q] and free[k] and not apart > radius[q]:
                near.append((int(np.bitwise_count(wanted[q] ^ known[k]).sum()), k))
        if not near:
            continue
        near.sort(key=lambda pair: pair[0])
        (best, k), second = near[0], near[1] if len(near) > 1 else (999, -1)
        tied = second[0] == best
        rival = second[1] >= 0 and octave[second[1]] == octave[k] and best > ratio * second[0]
        if best <= most and not rival and not tied:
            wins.setdefault(k, []).append((best, q))
    return {(min(queries)[1], k) for k, queries in wins.items()}


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), ratio=st.sampled_from([1.0, 0.9, 0.6]))
def test_matches_equal_brute_force(seed: int, ratio: float) -> None:
    rng = np.random.default_rng(seed)
    num_q, num_k = int(rng.integers(1, 25)), int(rng.integers(0, 40))
    measured = rng.uniform(0, 120, (num_k, 3)).astype(np.float32)
    measured[rng.random(num_k) < 0.4, 2] = np.nan
    known = rng.integers(0, 256, (num_k, 32)).astype(np.uint8)
    octave = rng.integers(0, 4, num_k).astype(np.uint8)
    source = rng.integers(0, max(num_k, 1), num_q)
    wanted = rng.integers(0, 256, (num_q, 32)).astype(np.uint8)
    proj = rng.uniform(-30, 150, (3, num_q))
    if num_k:
        wanted = known[source] ^ (rng.random((num_q, 32)) < 0.3).astype(np.uint8)
        proj = measured[source].T.astype(np.float64) + rng.normal(0, 4, (3, num_q))
    radius = rng.uniform(1, 60, num_q)
    low = rng.integers(0, 3, num_q).astype(np.int8)
    high = (low + 1).astype(np.int8)
    free = rng.random(num_k) < 0.8
    found = match_by_projection(
        proj,
        radius,
        QueryConstraints(low, high, wanted),
        Candidates(measured, octave, known, free),
        MatchThreshold(60, ratio),
    )
    expected = brute_force(
        proj, radius, low, high, wanted, measured, octave, known, free, 60, ratio
    )
    mine = set(zip(found.q.tolist(), found.k.tolist(), strict=True))
    assert len(set(found.k.tolist())) == len(found.k)
    assert expected <= mine or ratio == 1.0
    for q, k, distance in zip(found.q, found.k, found.distance, strict=True):
        assert distance == np.bitwise_count(wanted[q] ^ known[k]).sum() <= 60
    assert mine == expected


def test_no_features_give_no_matches() -> None:
    no_descriptors = np.empty((0, 32), np.uint8)
    none = match_by_projection(
        np.zeros((3, 1)),
        np.ones(1),
        QueryConstraints(np.zeros(1, np.int8), np.ones(1, np.int8), np.zeros((1, 32), np.uint8)),
        Candidates(np.empty((0, 3), np.float32), np.empty(0, np.uint8), no_descriptors),
        MatchThreshold(60, 1.0),
    )
    assert len(none.q) == 0


def test_a_contested_feature_goes_to_the_nearer_query() -> None:
    known = np.zeros((1, 32), np.uint8)
    wanted = np.zeros((2, 32), np.uint8)
    wanted[0, 0] = 0b111
    wanted[1, 0] = 0b1
    pairs = match_by_projection(
        np.full((3, 2), 10.0),
        np.full(2, 5.0),
        QueryConstraints(np.zeros(2, np.int8), np.zeros(2, np.int8), wanted),
        Candidates(np.array([[10, 10, np.nan]], np.float32), np.zeros(1, np.uint8), known),
        MatchThreshold(60, 1.0),
    )
    assert (pairs.q.tolist(), pairs.k.tolist(), pairs.distance.tolist()) == ([1], [0], [1])
