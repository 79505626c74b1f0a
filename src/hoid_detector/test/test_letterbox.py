"""Values of the network input, and boxes converted to it and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hoid_detector.model.letterbox import (
    VALUE_RANGES,
    Letterbox,
    Preprocessing,
    open_size,
    placement,
)

SIDES = st.integers(8, 2000)


@pytest.mark.parametrize(
    ('rgb', 'value_range', 'mode', 'rows', 'pixel', 'gray'),
    [
        (True, 'unit', 'centered', slice(2, 6), (30 / 255, 20 / 255, 10 / 255), (114 / 255,) * 3),
        (False, 'byte', 'top_left', slice(0, 4), (10, 20, 30), (114,) * 3),
        (True, 'byte', 'stretch', slice(0, 8), (30, 20, 10), (114,) * 3),
        # By hand: (30 / 255 - 0.485) / 0.229, and so on.
        (
            True, 'imagenet', 'top_left', slice(0, 4),
            (-1.604161, -1.685574, -1.630153), (-0.165682, -0.039916, 0.182484),
        ),
        (
            False, 'imagenet', 'top_left', slice(0, 4),
            (-1.630153, -1.685574, -1.604161), (0.182484, -0.039916, -0.165682),
        ),
    ],
)  # fmt: skip
def test_the_input_holds_the_image_and_gray_padding(
    rgb: bool,
    value_range: str,
    mode: str,
    rows: slice,
    pixel: tuple[float, ...],
    gray: tuple[float, ...],
) -> None:
    letterbox = Letterbox(Preprocessing(rgb, value_range, mode), np.float32)
    image = np.empty((4, 8, 3), np.uint8)
    image[:] = 10, 20, 30
    blob, _ = letterbox(image, (8, 8))
    assert blob.shape == (1, 3, 8, 8)
    expected = np.empty((1, 3, 8, 8), np.float32)
    expected[:] = np.array(gray)[:, None, None]
    expected[0, :, rows] = np.array(pixel)[:, None, None]
    np.testing.assert_allclose(blob, expected, rtol=1e-5)


def test_buffer_is_cleared_when_the_image_changes_its_shape() -> None:
    letterbox = Letterbox(Preprocessing(True, 'byte', 'centered'), np.float32)
    letterbox(np.full((8, 8, 3), 255, np.uint8), (8, 8))
    blob, _ = letterbox(np.zeros((4, 8, 3), np.uint8), (8, 8))
    assert (blob[0, :, :2] == 114).all()
    assert (blob[0, :, 2:6] == 0).all()


@pytest.mark.parametrize('value_range', VALUE_RANGES)
def test_half_floats_hold_the_same_values(value_range: str) -> None:
    image = np.random.default_rng(0).integers(0, 256, (8, 8, 3), np.uint8)
    preprocessing = Preprocessing(True, value_range, 'stretch')
    half = Letterbox(preprocessing, np.float16)(image, (8, 8))[0]
    full = Letterbox(preprocessing, np.float32)(image, (8, 8))[0]
    assert half.dtype == np.float16
    np.testing.assert_allclose(half, full, atol=2e-3)


@given(SIDES, SIDES, SIDES, SIDES, st.sampled_from(['centered', 'top_left', 'stretch']))
def test_boxes_survive_the_conversion_to_the_input_and_back(
    width: int, height: int, to_width: int, to_height: int, mode: str
) -> None:
    place = placement((width, height), (to_width, to_height), mode)
    assert place.left_px + place.width_px <= to_width
    assert place.top_px + place.height_px <= to_height
    box = np.array([[0, 0, width, height], [width / 4, 0, width / 2, height / 3]])
    scale = np.array([place.scale_x, place.scale_y] * 2)
    in_input = box * scale + np.array([place.left_px, place.top_px] * 2)
    back = place.boxes_to_image(in_input.astype(np.float32))
    np.testing.assert_allclose(back, box, atol=1e-3 * max(width, height))


@given(SIDES, SIDES, st.integers(32, 1280))
def test_an_open_input_size_is_the_smallest_multiple_of_the_stride(
    width: int, height: int, longest: int
) -> None:
    got = open_size((width, height), longest)
    scale = longest / max(width, height)
    for side, network in zip((width, height), got, strict=True):
        assert network % 32 == 0
        assert round(side * scale) <= network
        assert network < max(1, round(side * scale)) + 32
