"""Points that are followed, held against OpenCV and against motions that are known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from hoid_native import FlowPyramid, FlowSearch, follow_points
from hoid_native.results import Followed

STEPS, LEAST_PX = 8, 0.03
MARGIN_PX, RETURN_PX = 3.0, 0.5


def picture(seed: int, shape: tuple[int, int] = (120, 161)) -> np.ndarray:
    noise = np.random.default_rng(seed).uniform(0, 255, shape).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 1.5).clip(0, 255).astype(np.uint8)


def shifted(image: np.ndarray, x_px: float, y_px: float) -> np.ndarray:
    T = np.array([[1.0, 0.0, x_px], [0.0, 1.0, y_px]])
    return cv2.warpAffine(image, T, image.shape[::-1], borderMode=cv2.BORDER_REFLECT_101)


def points(seed: int, count: int, shape: tuple[int, int]) -> np.ndarray:
    """Return points in an image and up to 12 px beyond its edges."""
    far_px = np.array(shape[::-1]) + 12.0
    return np.random.default_rng(seed).uniform(-12.0, far_px, (count, 2)).astype(np.float32)


def follow(
    before: FlowPyramid, now: FlowPyramid, from_px: np.ndarray, guess_px: np.ndarray,
    levels: int = 2, steps: int = STEPS, least_px: float = LEAST_PX,
) -> Followed:  # fmt: skip
    search = FlowSearch(levels, max(levels - 1, 1), steps, least_px, MARGIN_PX, RETURN_PX)
    return follow_points(before, now, from_px, guess_px, search)


def opencv(
    before: np.ndarray, now: np.ndarray, from_px: np.ndarray, guess_px: np.ndarray, levels: int
) -> tuple[np.ndarray, np.ndarray]:
    uv_px, found, _ = cv2.calcOpticalFlowPyrLK(
        before, now, from_px, guess_px.copy(), winSize=(9, 9), maxLevel=levels - 1,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, STEPS, LEAST_PX),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW | cv2.OPTFLOW_LK_GET_MIN_EIGENVALS,
    )  # fmt: skip
    return np.asarray(uv_px), found.ravel() > 0


@pytest.mark.parametrize('levels', [1, 2, 3])
@pytest.mark.parametrize('seed', range(4))
def test_points_go_where_opencv_has_them_go_bit_for_bit(seed: int, levels: int) -> None:
    shape = (120 + 7 * seed, 161 - 10 * seed)
    before = picture(seed, shape)
    now = shifted(before, 1.7, -0.6)
    from_px = points(seed, 500, shape)
    guess_px = from_px + np.random.default_rng(seed).normal(0, 2, from_px.shape).astype(np.float32)
    uv_px, gone = opencv(before, now, from_px, guess_px, levels)
    back_px, returned = opencv(
        now, before, uv_px, uv_px - (guess_px - from_px), max(levels - 1, 1)
    )
    inside = ((uv_px >= MARGIN_PX) & (uv_px <= np.array(shape[::-1]) - 1 - MARGIN_PX)).all(axis=1)
    told = gone & returned & inside & (np.abs(back_px - from_px).max(axis=1) < RETURN_PX)
    ours = follow(FlowPyramid(before, levels), FlowPyramid(now, levels), from_px, guess_px, levels)
    assert 100 < told.sum() < (gone & returned & inside).sum() < 500
    assert (ours.found == told).all()
    assert (ours.uv_px[gone] == uv_px[gone]).all()


def waves(x_px: float, y_px: float) -> np.ndarray:
    """Return a picture that can be moved by any share of a pixel without loss."""
    y, x = np.mgrid[0:120, 0:160]
    x, y = x - x_px, y - y_px
    level = np.sin(0.5 * x + 0.1 * y) + np.sin(0.4 * y - 0.2 * x) + np.sin(0.17 * x + 0.3 * y)
    return np.asarray(np.rint(127 + 40 * level), np.uint8)


def test_a_shift_is_found_to_a_tenth_of_a_pixel() -> None:
    from_px = np.stack(np.meshgrid(np.arange(20, 140, 12.0), np.arange(20, 100, 12.0)), axis=-1)
    from_px = from_px.reshape(-1, 2).astype(np.float32)
    before, now = (FlowPyramid(waves(*shift_px), 3) for shift_px in ((0.0, 0.0), (2.25, -1.5)))
    found = follow(before, now, from_px, from_px, 3, 20, 0.005)
    assert found.found.all()
    assert np.abs(found.uv_px - from_px - (2.25, -1.5)).max() < 0.1


def test_nothing_is_found_without_texture_or_where_no_image_is() -> None:
    blank, other = FlowPyramid(np.full((60, 80), 90, np.uint8), 2), FlowPyramid(picture(1), 2)
    inside = np.array([[40, 30]], np.float32)
    assert not follow(blank, blank, inside, inside, 2).found.any()
    nowhere = np.array([[-99, 30], [1e30, 5], [np.nan, 5], [np.inf, -np.inf]], np.float32)
    assert not follow(other, other, nowhere, nowhere, 2).found.any()
    at = np.broadcast_to(inside, nowhere.shape).copy()
    assert not follow(other, other, at, nowhere, 2).found.any()


@pytest.mark.parametrize('shape', [(1, 1), (1, 40), (5, 7), (19, 25), (480, 1)])
def test_an_image_of_any_size_is_taken(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 255, shape, np.uint8)
    pyramid = FlowPyramid(image, 4)
    assert pyramid.size_px == shape[::-1]
    at = points(0, 50, shape)
    found = follow(pyramid, pyramid, at, at, 4)
    assert np.isfinite(found.uv_px).all()
    assert np.abs(found.uv_px - at)[found.found].max(initial=0.0) < 0.01


def test_what_does_not_fit_together_is_refused() -> None:
    small, large = FlowPyramid(picture(0), 1), FlowPyramid(picture(0, (60, 80)), 1)
    at = np.zeros((3, 2), np.float32)
    with pytest.raises(ValueError, match='image_gray'):
        FlowPyramid(np.empty((0, 5), np.uint8), 1)
    with pytest.raises(ValueError, match='num_levels'):
        FlowPyramid(picture(0), 0)
    with pytest.raises(ValueError, match='guess_px'):
        follow(small, small, at, at[:2], 1)
    with pytest.raises(ValueError, match='num_steps'):
        follow(small, small, at, at, 1, 0)
    with pytest.raises(ValueError, match='as large'):
        follow(small, large, at, at, 1)
