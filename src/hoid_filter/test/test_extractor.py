"""ORB features: their distribution, repeatability, subpixel positions and descriptors."""

from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hoid_common.values import BoolArray, ByteArray, Features, Float32Array
from hoid_filter.config import ExtractionConfig
from hoid_filter.extraction.extractor import OrbExtractor, octave_budgets, structure_shares
from hoid_filter.extraction.pyramid import build_pyramid

HEIGHT, WIDTH = 480, 640


@pytest.fixture(scope='module')
def image_gray() -> ByteArray:
    rng = np.random.default_rng(7)
    coarse = rng.integers(0, 256, (HEIGHT // 8, WIDTH // 8), dtype=np.uint8)
    resized = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return np.asarray(resized, np.uint8)


@dataclass(frozen=True)
class OneLevel(ExtractionConfig):
    """Without a pyramid, so that the corners are those of the image."""

    num_levels: ClassVar[int] = 1


PYRAMID, ONE_LEVEL = ExtractionConfig(), OneLevel()


def extract(
    image_gray: ByteArray,
    depth_m: Float32Array,
    is_static: BoolArray | None = None,
    config: ExtractionConfig = PYRAMID,
    stamp_ns: int = 0,
) -> Features:
    extractor = OrbExtractor(config)
    corners = extractor.detect(image_gray)
    area_px = image_gray.size
    kept = None
    if is_static is not None:
        kept = np.flatnonzero(is_static.ravel()[corners.pixel])
        area_px = int(np.count_nonzero(is_static))
    chosen = extractor.choose(corners, kept, area_px)
    return extractor.describe(corners, chosen, depth_m, stamp_ns)


@pytest.fixture
def depth_m() -> Float32Array:
    return np.full((HEIGHT, WIDTH), 2.0, np.float32)


def test_fills_the_budget_over_the_whole_image(
    image_gray: ByteArray, depth_m: Float32Array
) -> None:
    features = extract(image_gray, depth_m, stamp_ns=5)
    assert len(features) == 1000
    assert features.stamp_ns == 5
    assert features.depth_m.min() == features.depth_m.max() == 2.0
    u_px, v_px = features.uv_px.T
    counts, *_ = np.histogram2d(u_px, v_px, bins=(8, 6), range=((0, WIDTH), (0, HEIGHT)))
    assert counts.min() >= 5
    assert np.bincount(features.octave).tolist() == [217, 181, 151, 126, 104, 88, 72, 61]


def test_refills_the_budget_outside_the_mask(image_gray: ByteArray, depth_m: Float32Array) -> None:
    is_static = np.ones((HEIGHT, WIDTH), np.bool_)
    is_static[:, 200:500] = False
    features = extract(image_gray, depth_m, is_static)
    assert len(features) == 1000
    columns = np.rint(features.uv_px[:, 0]).astype(int)
    assert not ((columns > 201) & (columns < 498)).any()  # a coarse level's pixel is 3.6 wide


def test_same_image_same_features(image_gray: ByteArray, depth_m: Float32Array) -> None:
    first, second = (extract(image_gray, depth_m) for _ in range(2))
    assert np.array_equal(first.uv_px, second.uv_px)
    assert np.array_equal(first.descriptors, second.descriptors)


def test_rotated_image_gives_rotated_features(
    image_gray: ByteArray, depth_m: Float32Array
) -> None:
    """A quarter turn moves positions exactly, turns angles by 90 degrees and keeps descriptors."""
    square = image_gray[:, :HEIGHT].copy()
    depth = depth_m[:, :HEIGHT]
    plain = extract(square, depth, config=ONE_LEVEL)
    turned = extract(np.rot90(square, -1).copy(), depth, config=ONE_LEVEL)
    expected = np.column_stack([HEIGHT - 1 - plain.uv_px[:, 1], plain.uv_px[:, 0]])
    gaps = np.abs(expected[:, None] - turned.uv_px[None]).sum(2)
    i, k = np.nonzero(gaps < 0.5)
    assert len(i) > 600
    turn_deg = (turned.angle_deg[k] - plain.angle_deg[i]) % 360
    assert np.median(np.abs(turn_deg - 90)) < 1
    distance = np.bitwise_count(plain.descriptors[i] ^ turned.descriptors[k]).sum(1)
    assert np.median(distance) < 20


def test_features_follow_a_move_by_less_than_a_pixel(depth_m: Float32Array) -> None:
    noise = np.random.default_rng(7).integers(0, 256, (HEIGHT, WIDTH)).astype(np.uint8)
    smooth = cv2.GaussianBlur(noise.astype(np.float32), (0, 0), 1.5)
    image_gray = 255 * (smooth - smooth.min()) / (smooth.max() - smooth.min())
    move_px = np.array([0.4, -0.3], np.float32)
    to_moved = np.column_stack([np.eye(2), move_px])
    moved_gray = cv2.warpAffine(image_gray, to_moved, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    before, after = (
        extract(np.asarray(gray, np.uint8), depth_m, config=ONE_LEVEL)
        for gray in (image_gray, moved_gray)
    )
    steps_px = after.uv_px[None] - before.uv_px[:, None]
    errors_px = np.linalg.norm(steps_px - move_px, axis=2).min(axis=1)
    assert np.median(errors_px) < 0.2  # a whole pixel would be wrong by 0.5


def test_features_lie_within_the_pixels_of_their_corners(
    image_gray: ByteArray, depth_m: Float32Array
) -> None:
    extractor = OrbExtractor(ExtractionConfig())
    corners = extractor.detect(image_gray)
    chosen = extractor.choose(corners, None, image_gray.size)
    features = extractor.describe(corners, chosen, depth_m, 0)
    moved = features.uv_px - corners.uv_px[chosen]
    assert (np.abs(moved) <= 0.5 * corners.pyramid.steps_px[features.octave] + 1e-4).all()
    assert (moved != 0).any(axis=1).mean() > 0.5


def test_descriptors_are_those_of_opencv_at_the_same_pixels(
    image_gray: ByteArray, depth_m: Float32Array
) -> None:
    extractor = OrbExtractor(ONE_LEVEL)
    corners = extractor.detect(image_gray)
    features = extractor.describe(corners, np.arange(0, len(corners), 7), depth_m, 0)
    points = [
        cv2.KeyPoint(x, y, 31, angle, 1.0, 0)
        for (x, y), angle in zip(
            corners.xy_px[::7].tolist(), features.angle_deg.tolist(), strict=True
        )
    ]
    _, expected = cv2.ORB.create(nlevels=1, edgeThreshold=19).compute(image_gray, points)
    assert len(points) > 300
    assert np.array_equal(features.descriptors, expected)


def test_a_dim_image_has_features_of_low_contrast(
    image_gray: ByteArray, depth_m: Float32Array
) -> None:
    """As of a plain wall: hardly any corner reaches the threshold of ORB-SLAM3."""
    dim = (120 + (image_gray.astype(np.float64) - 128) / 24).round().astype(np.uint8)
    corners = OrbExtractor(ExtractionConfig()).detect(dim)
    assert np.count_nonzero(corners.score >= ExtractionConfig.fast_threshold) < 1000
    assert corners.score.min() >= ExtractionConfig.low_fast_threshold
    assert len(extract(dim, depth_m)) == 1000
    bright = OrbExtractor(ExtractionConfig()).detect(image_gray)
    assert bright.score.min() >= ExtractionConfig.fast_threshold


def test_in_a_blur_with_noise_features_come_from_coarser_levels(
    image_gray: ByteArray, depth_m: Float32Array
) -> None:
    rng = np.random.default_rng(7)
    blurred = cv2.GaussianBlur(image_gray, (0, 0), 3)
    noisy = np.clip(blurred + rng.normal(0, 6, blurred.shape), 0, 255).astype(np.uint8)
    fixed = extract(noisy, depth_m, config=ExtractionConfig(adapt_levels=False))
    adapted = extract(noisy, depth_m)
    assert len(fixed) == len(adapted) == 1000
    counts = [np.bincount(features.octave) for features in (fixed, adapted)]
    assert counts[0].tolist() == [217, 181, 151, 126, 104, 88, 72, 61]
    assert counts[1][0] < 0.6 * counts[0][0]
    assert (counts[1][3:] > 1.2 * counts[0][3:]).all()


def test_shares_of_structure() -> None:
    """A level has at most the density of corners of any coarser one."""
    pyramid = build_pyramid(np.zeros((HEIGHT, WIDTH), np.uint8), 3, 2.0)  # 480, 240, 120 px high
    area_px = np.array([480 * 640, 240 * 320, 120 * 160])
    for densities, expected in (
        ((1, 2, 4), (1, 1, 1)),  # sharp
        ((8, 2, 4), (0.25, 1, 1)),
        ((8, 4, 2), (0.25, 0.5, 1)),
        ((0, 4, 0), (1, 0, 1)),
    ):
        counts = (np.array(densities) * area_px / 1000).astype(np.int64)
        shares = structure_shares(counts, pyramid, 0)
        np.testing.assert_allclose(shares, expected, atol=0.02)
    small = build_pyramid(np.zeros((80, 90), np.uint8), 8, 1.2)
    np.testing.assert_array_equal(structure_shares(np.array([9] + [0] * 7), small, 19), 1)


def test_blank_image_gives_no_features(depth_m: Float32Array) -> None:
    features = extract(np.full((HEIGHT, WIDTH), 90, np.uint8), depth_m)
    assert len(features) == 0
    assert features.descriptors.shape == (0, 32)


def test_depth_is_that_of_the_nearest_pixel(image_gray: ByteArray) -> None:
    ramp_m = np.linspace(2.0, 2.5, HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)
    features = extract(image_gray, ramp_m)
    column, row = np.rint(features.uv_px).astype(int).T
    np.testing.assert_array_equal(features.depth_m, ramp_m[row, column])


def test_budgets_follow_inverse_scale() -> None:
    assert octave_budgets(1000, 8, 1.2).tolist() == [217, 181, 151, 126, 104, 88, 72, 61]


@given(st.integers(50, 5000), st.integers(1, 16), st.floats(1.01, 2.0))
def test_budgets_add_up(num: int, levels: int, scale: float) -> None:
    budgets = octave_budgets(num, levels, scale)
    assert budgets.sum() == num
    assert (budgets >= 0).all()
