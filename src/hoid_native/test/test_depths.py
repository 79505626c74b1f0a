import numpy as np
import pytest

from hoid_native import box_center_depths_m


def test_median_of_the_readings_at_the_center() -> None:
    depth_m = np.full((40, 60), 3.0, np.float32)
    depth_m[18:22, 28:32] = [[1.0, 1.0, 1.0, 1.0], [2.0, 2.0, 2.0, 2.0]] * 2
    centered = np.array([[20.0, 10.0, 40.0, 30.0]])
    assert box_center_depths_m(depth_m, centered, 4).tolist() == [1.5]
    assert box_center_depths_m(depth_m, centered, 40).tolist() == [3.0]


def test_missing_readings_do_not_count() -> None:
    depth_m = np.full((40, 60), np.nan, np.float32)
    depth_m[:, ::2] = 0.0
    box = np.array([[20.0, 10.0, 40.0, 30.0]])
    assert np.isnan(box_center_depths_m(depth_m, box, 10)).all()
    depth_m[20, 30] = 2.5
    assert box_center_depths_m(depth_m, box, 10).tolist() == [2.5]


def test_square_beyond_the_image_repeats_its_edge() -> None:
    depth_m = np.ones((40, 60), np.float32)
    depth_m[:, 0] = 4.0
    corner = np.array([[-10.0, -10.0, 10.0, 10.0], [0.0, 0.0, 8.0, 8.0]], np.float32)
    assert box_center_depths_m(depth_m, corner, 10).tolist() == [4.0, 1.0]


def test_equals_numpys_median() -> None:
    rng = np.random.default_rng(0)
    depth_m = rng.uniform(0.5, 5, (480, 640)).astype(np.float32)
    corner = rng.integers(0, 200, (50, 2)) * 2.0
    boxes = np.concatenate([corner, corner + 60.0], 1)
    squares = [depth_m[int(y) + 25 : int(y) + 35, int(x) + 25 : int(x) + 35] for x, y in corner]
    expected = [np.median(square.astype(np.float64)) for square in squares]
    np.testing.assert_allclose(box_center_depths_m(depth_m, boxes, 10), expected, rtol=1e-12)


@pytest.mark.parametrize('side_px', [1, 2, 5, 10])
def test_median_equals_numpys_to_the_bit(side_px: int) -> None:
    """The medians are equal for few and many, odd and even, equal and scattered readings."""
    rng = np.random.default_rng(side_px)
    for spread_m in (0.0, 1e-6, 0.01, 1.0, 60.0):
        depth_m = (0.3 + rng.random((40, 60)) * spread_m).astype(np.float32)
        depth_m[rng.random(depth_m.shape) < 0.4] = 0.0
        depth_m[rng.random(depth_m.shape) < 0.2] = depth_m[0].max()
        corner = rng.integers(0, 30, (200, 2))
        squares = [depth_m[y : y + side_px, x : x + side_px] for x, y in corner]
        expected = [np.median(s[s > 0].astype(np.float64)) if s.any() else np.nan for s in squares]
        boxes = np.concatenate([corner, corner + side_px], 1)
        np.testing.assert_array_equal(box_center_depths_m(depth_m, boxes, side_px), expected)


def test_no_boxes_no_depths() -> None:
    assert box_center_depths_m(np.ones((4, 4), np.float32), np.empty((0, 4)), 10).shape == (0,)
