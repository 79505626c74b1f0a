"""Upright boxes of turned furniture, in level and in tilted frames."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from hoid_common import se3
from hoid_common.values import FloatArray
from hoid_scene.level.upright_box import Level, extended_back, on_floor, upright_box

UP = np.array([0.0, 0.0, 1.0])


def turned(angle_deg: float, axis: ArrayLike) -> FloatArray:
    """Return a rotation (4, 4) about an axis (3,)."""
    return se3.exp(np.r_[np.deg2rad(angle_deg) * np.asarray(axis, float), 0, 0, 0])


def table(seed: int = 0) -> FloatArray:
    """Return points on a table top of 1.6 x 0.8 m at a height of 0.7 m, with two of its sides."""
    rng = np.random.default_rng(seed)
    top = rng.uniform([-0.8, -0.4, 0.7], [0.8, 0.4, 0.7], (3000, 3))
    front = rng.uniform([-0.8, -0.4, 0.62], [0.8, -0.4, 0.7], (400, 3))
    side = rng.uniform([0.8, -0.4, 0.62], [0.8, 0.4, 0.7], (200, 3))
    return np.concatenate([top, front, side]) + rng.normal(0, 0.004, (3600, 3))


def error_deg(axes: FloatArray, true_axis: FloatArray) -> float:
    """Return the angle between an axis and the nearest one of two horizontal sides."""
    return float(np.degrees(np.arccos(np.abs(true_axis @ axes[:, :2]).max().clip(max=1.0))))


@pytest.mark.parametrize('angle_deg', [0, 7, 20, 45, 60, 80])
@pytest.mark.parametrize('tilt_deg', [0, 25])
def test_a_turned_table_has_its_own_size_heading_and_center(
    angle_deg: float, tilt_deg: float
) -> None:
    T = turned(tilt_deg, [1, 0, 0]) @ turned(angle_deg, UP)
    T[:3, 3] = 1.0, -2.0, 0.3
    box = upright_box(se3.transform(T, table()), Level(T[:3, :3] @ UP))
    assert sorted(box.size_m[:2]) == pytest.approx([0.8, 1.6], abs=0.07)  # 2 % is cut on each side
    assert box.size_m[:2].prod() == pytest.approx(1.28, rel=0.15)
    assert error_deg(box.axes, T[:3, 0]) < 2.0
    np.testing.assert_allclose(box.axes[:, 2], T[:3, :3] @ UP, atol=1e-9)
    center_m = se3.transform(T, np.array([[0.0, 0.0, 0.66]]))[0]
    np.testing.assert_allclose(box.center_m, center_m, atol=0.03)
    np.testing.assert_allclose(box.pose[:3, :3].T @ box.pose[:3, :3], np.eye(3), atol=1e-9)
    assert np.linalg.det(box.pose[:3, :3]) == pytest.approx(1.0)


def test_a_round_table_stands_along_the_walls() -> None:
    rng = np.random.default_rng(1)
    angle, radius = rng.uniform(0, 2 * np.pi, 3000), 0.5 * np.sqrt(rng.uniform(0, 1, 3000))
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(3000, 0.7)], 1)
    wall = turned(33, UP)[:3, 0]
    assert error_deg(upright_box(points, Level(UP, wall)).axes, wall) < 1e-6


def test_the_first_side_is_the_one_nearest_to_x() -> None:
    for angle_deg in range(-40, 41, 10):
        T = turned(angle_deg, UP)
        box = upright_box(se3.transform(T, table()), Level(UP))
        assert box.axes[0, 0] > np.cos(np.deg2rad(46))
        assert box.size_m[0] == pytest.approx(1.6, abs=0.07)


def test_a_screen_that_was_seen_from_the_front_is_extended_away_from_the_camera() -> None:
    rng = np.random.default_rng(2)
    screen = rng.uniform([-0.3, 0.0, 0], [0.3, 0.01, 0.4], (2000, 3))
    T = turned(30, UP)
    box = upright_box(se3.transform(T, screen), Level(UP))
    back = extended_back(box, T[:3, 1])
    moved_m = back.center_m - box.center_m
    assert min(back.size_m[:2]) == pytest.approx(0.15)
    np.testing.assert_allclose(moved_m, 0.07 * T[:3, 1], atol=0.006)
    assert extended_back(box, 0.5 * T[:3, 1]) == box


def test_furniture_reaches_to_the_floor_and_shelves_do_not() -> None:
    box = upright_box(table(), Level(UP))
    standing = on_floor(box, height_m=0.66)
    assert standing.low_m[2] == pytest.approx(0.0, abs=0.02)
    assert standing.high_m[2] == box.high_m[2]
    assert on_floor(box, height_m=1.9) == box
