"""Measurement of detections on depth images with holes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import CameraModel, DynamicObject, ObjectState
from hoid_scene.tracks.object_sighting import DepthImage, measure

CAMERA = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
BOX_PX = (40.0, 40.0, 88.0, 88.0)
NAMES = ('person', 'cup')


def box(class_name: str, box_px: tuple[float, float, float, float] = BOX_PX) -> DynamicObject:
    return DynamicObject(class_name, box_px, 0.9, -1, ObjectState.HANDLED)


@pytest.mark.parametrize('class_name', NAMES)
def test_readings_only_at_the_border_of_a_box_are_enough(class_name: str) -> None:
    depth_m = np.full((120, 160), 2.0, np.float32)
    depth_m[44:84, 44:84] = 0
    found = measure(box(class_name), DepthImage.of(CAMERA, depth_m, T_BODY_OPTICAL), None, None)
    assert found is not None
    assert found.position_map_m[0] == pytest.approx(2.0, abs=0.2)


def test_the_size_is_also_right_where_only_the_border_of_a_box_has_readings() -> None:
    """The front of an object, 1.85 m wide and 1.23 m high, 2 m away."""
    depth_m = np.full((120, 160), 2.0, np.float32)
    depth_m[24:96, 24:136] = 0
    image = DepthImage.of(CAMERA, depth_m, T_BODY_OPTICAL)
    found = measure(box('cup', (20.0, 20.0, 140.0, 100.0)), image, None, None)
    assert found is not None
    np.testing.assert_allclose(found.size_m, [0, 120 * 2 / 130, 80 * 2 / 130], rtol=0.06)


@pytest.mark.parametrize('class_name', NAMES)
def test_a_box_without_readings_gives_no_sighting(class_name: str) -> None:
    image = DepthImage.of(CAMERA, np.zeros((120, 160), np.float32), T_BODY_OPTICAL)
    assert measure(box(class_name), image, np.array([2.0, 0.0, 0.0]), None) is None


@given(
    class_name=st.sampled_from(NAMES),
    seed=st.integers(0, 10_000),
    filled=st.floats(0.0, 1.0),
    spread_m=st.floats(0.0, 3.0),
    corners=st.tuples(*[st.floats(-20, 180)] * 4),
    known_m=st.one_of(st.none(), st.floats(0.1, 6.0)),
)
def test_any_depth_gives_a_place_within_the_range_of_the_readings_or_none(
    class_name: str,
    seed: int,
    filled: float,
    spread_m: float,
    corners: tuple[float, float, float, float],
    known_m: float | None,
) -> None:
    rng = np.random.default_rng(seed)
    depth_m = rng.uniform(1.0, 1.0 + spread_m, (120, 160)).astype(np.float32)
    depth_m[rng.random(depth_m.shape) > filled] = 0
    x1, y1, x2, y2 = corners
    seen = box(class_name, (min(x1, x2), min(y1, y2), max(x1, x2) + 1, max(y1, y2) + 1))
    known = None if known_m is None else np.array([known_m, 0.0, 0.0])
    found = measure(seen, DepthImage.of(CAMERA, depth_m, T_BODY_OPTICAL), known, None)
    if found is not None:
        assert np.isfinite(found.position_map_m).all()
        assert np.isfinite(found.size_m).all()
        assert 0.9 < found.position_map_m[0] < 1.3 + spread_m
