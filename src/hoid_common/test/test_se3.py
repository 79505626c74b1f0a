import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hoid_common import se3
from hoid_common.values import FloatArray

# Rotation vectors below half a turn, where exp and log are each other's inverse.
angles = st.floats(0, np.pi - 1e-3)
directions = arrays(np.float64, 3, elements=st.floats(-1, 1)).filter(
    lambda v: np.linalg.norm(v) > 0.1
)
places = arrays(np.float64, 3, elements=st.floats(-100, 100))


@st.composite
def twists(draw: st.DrawFn) -> FloatArray:
    axis = draw(directions)
    return np.concatenate([axis / np.linalg.norm(axis) * draw(angles), draw(places)])


def test_exp_of_a_quarter_turn_about_z() -> None:
    T = se3.exp(np.array([0, 0, np.pi / 2, 0, 0, 0.0]))
    np.testing.assert_allclose(
        T, [[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], atol=1e-15
    )


def test_exp_moves_along_an_arc() -> None:
    # Half a turn while driving pi meters along x goes round half a circle of radius 1.
    T = se3.exp(np.array([0, 0, np.pi, np.pi, 0, 0]))
    np.testing.assert_allclose(T[:3, 3], [0, 2, 0], atol=1e-15)


def test_pure_translation() -> None:
    T = se3.exp(np.array([0, 0, 0, 1.0, -2, 3]))
    np.testing.assert_array_equal(T[:3, :3], np.eye(3))
    np.testing.assert_array_equal(T[:3, 3], [1, -2, 3])


@given(twists())
def test_log_undoes_exp(twist: FloatArray) -> None:
    np.testing.assert_allclose(se3.log(se3.exp(twist)), twist, atol=1e-9 * 100)


@pytest.mark.parametrize('angle', [0.0, 1e-12, 1e-7, 0.9e-6, 1.1e-6, 1e-3])
def test_small_angles_lose_no_digits(angle: float) -> None:
    twist = np.array([angle, 0, 0, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(se3.log(se3.exp(twist)), twist, rtol=0, atol=1e-12)


def test_half_turns_keep_their_angle() -> None:
    for axis in np.eye(3):
        twist = np.concatenate([np.pi * axis, np.zeros(3)])
        assert np.linalg.norm(se3.log(se3.exp(twist))[:3]) == pytest.approx(np.pi)


@given(twists(), twists())
def test_inverse_of_a_product(a: FloatArray, b: FloatArray) -> None:
    T_a, T_b = se3.exp(a), se3.exp(b)
    np.testing.assert_allclose(
        se3.inverse(T_a @ T_b), se3.inverse(T_b) @ se3.inverse(T_a), atol=1e-10 * 200
    )


@given(twists())
def test_quaternion_round_trip(twist: FloatArray) -> None:
    T = se3.exp(twist)
    quat = se3.quat_xyzw_from_rotation(T[:3, :3])
    np.testing.assert_allclose(se3.from_quat_translation(quat, T[:3, 3]), T, atol=1e-12)


def test_quaternion_of_a_quarter_turn_about_x() -> None:
    R = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]])
    quat = se3.quat_xyzw_from_rotation(R)
    np.testing.assert_allclose(quat, [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])


def test_stacks_agree_with_single_ones() -> None:
    stack = np.random.default_rng(0).normal(size=(5, 7, 6))
    T = se3.exp(stack)
    assert T.shape == (5, 7, 4, 4)
    np.testing.assert_allclose(T[3, 4], se3.exp(stack[3, 4]))
    np.testing.assert_allclose(se3.log(T)[3, 4], se3.log(T[3, 4]))


def test_transform_maps_points() -> None:
    T = se3.exp(np.array([0, 0, np.pi / 2, 0, 0, 0.0]))
    T[:3, 3] = [1, 2, 3]
    np.testing.assert_allclose(se3.transform(T, np.array([[1.0, 0, 0]])), [[1, 3, 3]], atol=1e-15)


def test_orthonormalized_is_a_rotation_again() -> None:
    T = se3.exp(np.array([0.3, -0.2, 0.1, 1, 2, 3]))
    noisy = T.copy()
    noisy[:3, :3] += np.random.default_rng(1).normal(0, 1e-3, (3, 3))
    R = se3.orthonormalized(noisy)[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1)
    np.testing.assert_allclose(R, T[:3, :3], atol=5e-3)
    many = np.stack([T, noisy, T])
    np.testing.assert_allclose(se3.orthonormalized(many)[1], se3.orthonormalized(noisy))
