"""Registration of depth images: one pixel at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hoid_native import Pinhole, register_depth

CAMERA = Pinhole(100.0, 100.0, 10.0, 5.0)
RAYS = np.zeros((1, 2, 3), np.float32)
RAYS[..., 2] = 1.0


def registered(depth_m: list[float], t_m: Any = (0, 0, 0), side_px: Any = (1, 1)) -> Any:
    """Return the image of two depth pixels that look along the axis of a camera of 21 x 11 px."""
    depth = np.array([depth_m], np.float32)
    t, side = (np.array(values, np.float32) for values in (t_m, side_px))
    return register_depth(depth, RAYS, t, side, CAMERA, (21, 11))


def test_a_pixel_goes_where_the_camera_sees_it() -> None:
    image = registered([2.0, 0.0], t_m=(0.04, -0.02, 0.5))
    expected = np.zeros((11, 21), np.float32)
    expected[5 - 1, 10 + 2] = 2.5  # 0.04 m at 2.5 m are 1.6 px, -0.02 m are -0.8 px
    np.testing.assert_array_equal(image, expected)


def test_the_nearest_depth_is_kept() -> None:
    for depths in ([2.0, 1.0], [1.0, 2.0]):
        assert registered(depths)[5, 10] == 1.0


def test_a_large_pixel_covers_as_many_pixels() -> None:
    image = registered([1.0, 0.0], side_px=(3, 2))
    assert (image > 0).sum() == 6
    assert (image[4:6, 9:12] == 1.0).all()
    assert (registered([1.0, 0.0], side_px=(0.2, 0.2)) > 0).sum() == 1


@pytest.mark.parametrize('depth_m', [0.0, -1.0, np.nan])
def test_no_reading_stays_none(depth_m: float) -> None:
    assert not registered([depth_m, depth_m]).any()


@pytest.mark.parametrize('t_m', [(0, 0, -3), (1e9, 0, 0), (np.nan, 0, 0), (0.3, 0, 0)])
def test_points_behind_or_beside_the_image_are_left_out(t_m: Any) -> None:
    assert not registered([2.0, 1.0], t_m).any()


def test_a_pixel_at_the_border_covers_what_is_inside() -> None:
    image = registered([1.0, 0.0], t_m=(-0.1, -0.05, 0), side_px=(4, 4))
    assert np.flatnonzero(image.any(axis=0)).tolist() == [0, 1]
    assert np.flatnonzero(image.any(axis=1)).tolist() == [0, 1]


def test_arrays_of_other_sizes_are_refused() -> None:
    depth_m, two = np.ones((2, 2), np.float32), np.ones(2, np.float32)
    with pytest.raises(ValueError, match='rays: must be as large as depth_m'):
        register_depth(depth_m, RAYS, np.zeros(3, np.float32), two, CAMERA, (21, 11))
    with pytest.raises(ValueError, match='size_px: must be positive'):
        register_depth(depth_m[:1], RAYS, np.zeros(3, np.float32), two, CAMERA, (0, 11))
