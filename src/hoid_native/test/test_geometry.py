"""Least-squares kernels recover known poses, and use the derivatives of the projection."""

import pickle

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from hoid_native import Gates, StereoParams, adjust_bundle, evaluate_matches, optimize_pose


def stereo(
    disparity_noise_px: float = 0.3,
    relative_noise: float = 0.02,
    pixel_noise: float = 1.0,
    joint_noise: bool = False,
) -> StereoParams:
    noise = disparity_noise_px, relative_noise, pixel_noise, joint_noise
    return StereoParams(500.0, 510.0, 320.0, 240.0, 40.0, *noise)


CAMERA = stereo()
GATES = Gates(5.991, 7.815)
FloatArray = NDArray[np.float64]


def rotation(w: FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) of a rotation vector (3,) by Rodrigues' formula."""
    angle = np.linalg.norm(w)
    W = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]) / angle
    turn: FloatArray = np.eye(3) + np.sin(angle) * W + (1 - np.cos(angle)) * W @ W
    return turn


def pose(w: ArrayLike, t: ArrayLike) -> FloatArray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation(np.asarray(w, float)), t
    return T


def pixels(T: FloatArray, points: FloatArray) -> FloatArray:
    x, y, z = (points @ T[:3, :3].T + T[:3, 3]).T
    u = CAMERA.fx_px * x / z + CAMERA.cx_px
    return np.stack([u, CAMERA.fy_px * y / z + CAMERA.cy_px, u - CAMERA.disparity_px_m / z], 1)


def scene(seed: int, count: int) -> tuple[np.random.Generator, FloatArray]:
    rng = np.random.default_rng(seed)
    return rng, rng.uniform([-1.5, -1, 1.5], [1.5, 1, 5], (count, 3))


TRUTH = pose([0.1, -0.2, 0.15], [0.1, -0.05, 0.2])


def test_pose_is_found_with_outliers_and_without_some_depths() -> None:
    rng, points = scene(0, 120)
    measured = pixels(TRUTH, points)
    measured[::3, 2] = np.nan
    measured[:25, :2] += rng.choice([-1, 1], (25, 2)) * rng.uniform(10, 60, (25, 2))
    fit = optimize_pose(
        CAMERA, GATES, points, measured, np.ones(120), pose([0.1, -0.1, 0.1], [0] * 3)
    )
    np.testing.assert_allclose(fit.T_camera_map, TRUTH, atol=1e-9)
    assert fit.inliers.tolist() == [False] * 25 + [True] * 95


def test_match_costs_use_the_measured_noise_and_are_truncated_at_the_gates() -> None:
    points = np.array([[0.0, 0, 2], [0.1, 0, 2], [0, 0.1, 4], [0.2, 0, 2], [0, 0, -1]])
    measured = pixels(np.eye(4), points)
    measured[0] += [0.5, 0, 0.5]  # same disparity
    measured[1, 2] -= 0.25  # of a disparity of 20 px
    measured[2, :2] += [30, 0]
    measured[2, 2] = np.nan
    measured[3] += [40, 0, 0]
    camera = stereo(pixel_noise=0.5)
    cost, inliers = evaluate_matches(camera, GATES, points, measured, np.ones(5), np.eye(4))
    deviation = np.hypot(0.3, 0.02 * 20.25)
    expected = [1.0, (0.25 / deviation) ** 2, 5.991, 5.991 + 3.841, 5.991 + 3.841]
    np.testing.assert_allclose(cost, expected)
    assert inliers.tolist() == [True, True, False, False, False]
    joint = stereo(pixel_noise=0.5, joint_noise=True)
    cost, _ = evaluate_matches(joint, GATES, points, measured, np.ones(5), np.eye(4))
    np.testing.assert_allclose(cost, [2.0, 0.25, 5.991, 7.815, 7.815])


def test_information_equals_that_of_numeric_derivatives() -> None:
    _, points = scene(1, 40)
    measured = pixels(TRUTH, points)
    measured[::2, 2] = np.nan
    weight = np.linspace(0.3, 1, 40)
    step = 1e-6
    columns = []
    for a in range(6):
        twist = np.zeros(6)
        twist[a] = step
        moved = np.eye(4)
        moved[:3, :3] = rotation(twist[:3]) if a < 3 else np.eye(3)
        moved[:3, 3] = twist[3:]
        back = np.linalg.inv(moved)
        columns.append((pixels(moved @ TRUTH, points) - pixels(back @ TRUTH, points)) / (2 * step))
    J = np.stack(columns, -1)
    J[:, 2] = J[:, 0] - J[:, 2]
    disparity = measured[:, 0] - measured[:, 2]
    depth_weight = 1 / (CAMERA.disparity_noise_px**2 + (CAMERA.relative_noise * disparity) ** 2)
    weights = np.stack([weight, weight, np.nan_to_num(depth_weight)], 1)
    expected = np.einsum('kra,kr,krb->ab', J, weights, J)
    fit = optimize_pose(CAMERA, GATES, points, measured, weight, TRUTH)
    np.testing.assert_allclose(fit.information, expected, rtol=1e-6, atol=1e-3)


def test_joint_noise_weighs_u_right_like_u_and_v_under_one_kernel() -> None:
    """The result equals SciPy's for least squares on (u, v, u_right) with one Huber kernel."""
    rng, points = scene(7, 80)
    measured = pixels(TRUTH, points) + rng.normal(0, 0.8, (80, 3))
    measured[::4, 2] = np.nan
    weight = np.linspace(0.3, 1, 80)
    gate = np.where(np.isnan(measured[:, 2]), GATES.mono, GATES.stereo)

    def residuals(twist: FloatArray) -> FloatArray:
        moved = np.eye(4)
        moved[:3, :3], moved[:3, 3] = rotation(twist[:3] + 1e-300), twist[3:]
        seen = np.nan_to_num(pixels(moved @ TRUTH, points) - measured)
        chi = np.sqrt(weight) * np.linalg.norm(seen, axis=1)
        robust = np.sqrt(np.where(chi**2 <= gate, chi**2, 2 * np.sqrt(gate) * chi - gate))
        return np.asarray(robust[fit.inliers])

    camera = stereo(joint_noise=True)
    fit = optimize_pose(camera, GATES, points, measured, weight, TRUTH)
    T_found_truth = fit.T_camera_map @ np.linalg.inv(TRUTH)
    found = np.append(_rotation_vector(T_found_truth[:3, :3]), T_found_truth[:3, 3])
    best = least_squares(residuals, found, x_scale=1e-3)
    np.testing.assert_allclose(found, best.x, atol=1e-5)
    other = optimize_pose(CAMERA, GATES, points, measured, weight, TRUTH)
    assert np.abs(other.T_camera_map - fit.T_camera_map).max() > 1e-4


def _rotation_vector(R: FloatArray) -> FloatArray:
    """Return the rotation vector of a small rotation."""
    skew = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    size = np.linalg.norm(skew)
    vector: FloatArray = np.arcsin(size) / size * skew
    return vector


def test_a_wrong_depth_does_not_move_the_pose_much() -> None:
    _, points = scene(5, 100)
    measured = pixels(TRUTH, points)
    measured[:30, 2] -= 2.4
    fit = optimize_pose(CAMERA, GATES, points, measured, np.ones(100), TRUTH)
    assert fit.inliers.all()
    assert np.abs(fit.T_camera_map[:3, 3] - TRUTH[:3, 3]).max() < 0.012
    trusting = stereo(disparity_noise_px=0.05)
    exact = optimize_pose(trusting, GATES, points, pixels(TRUTH, points), np.ones(100), np.eye(4))
    np.testing.assert_allclose(exact.T_camera_map, TRUTH, atol=1e-9)


def test_points_behind_the_camera_are_outliers() -> None:
    _, points = scene(2, 50)
    measured = pixels(TRUTH, points)
    points[:5, 2] -= 20
    fit = optimize_pose(CAMERA, GATES, points, measured, np.ones(50), TRUTH)
    assert fit.inliers.tolist() == [False] * 5 + [True] * 45


def test_a_camera_travels_to_another_process() -> None:
    camera = pickle.loads(pickle.dumps(stereo(joint_noise=True)))  # noqa: S301
    assert (camera.fx_px, camera.relative_noise, camera.joint_noise) == (500.0, 0.02, True)


def test_too_few_points_leave_the_pose_alone() -> None:
    _, points = scene(3, 3)
    fit = optimize_pose(CAMERA, GATES, points, pixels(TRUTH, points), np.ones(3), np.eye(4))
    np.testing.assert_array_equal(fit.T_camera_map, np.eye(4))


def test_coordinates_of_another_shape_are_refused() -> None:
    with pytest.raises(TypeError, match='optimize_pose'):
        optimize_pose(CAMERA, GATES, np.zeros((3, 4)), np.zeros((4, 3)), np.ones(4), np.eye(4))
    with pytest.raises(ValueError, match='points_m: expected 4 rows, not 3'):
        optimize_pose(CAMERA, GATES, np.zeros((3, 3)), np.zeros((4, 3)), np.ones(4), np.eye(4))


def test_bundle_comes_back_to_the_truth() -> None:
    rng, points = scene(4, 150)
    poses = np.stack(
        [TRUTH, *(pose([0.02 * i, 0.03, 0.01], [0.15 * i, 0, 0.02 * i]) for i in range(1, 5))]
    )
    camera, point = (part.ravel() for part in np.mgrid[:5, :150])
    seen = rng.random(len(camera)) < 0.8
    camera, point = camera[seen], point[seen]
    measured = np.concatenate([pixels(T, points[point[camera == i]]) for i, T in enumerate(poses)])
    measured[rng.random(len(camera)) < 0.3, 2] = np.nan
    wrong = rng.random(len(camera)) < 0.03
    measured[wrong, 1] += 40
    start = poses.copy()
    for i in range(3):
        start[i] = pose(rng.normal(0, 0.01, 3), rng.normal(0, 0.01, 3)) @ poses[i]
    fit = adjust_bundle(
        CAMERA, GATES, start, 3, points + rng.normal(0, 0.01, points.shape), camera, point,
        measured, np.ones(len(camera)), 2, 15,
    )  # fmt: skip
    np.testing.assert_array_equal(fit.T_camera_map[3:], poses[3:])
    np.testing.assert_allclose(fit.T_camera_map[:3], poses[:3], atol=1e-6)
    well = np.bincount(point, minlength=150) >= 3
    assert np.median(np.abs(fit.points_m - points)[well]) < 1e-6
    assert ((fit.chi2 > GATES.mono) == wrong).mean() > 0.995
    assert fit.cost_after < 0.02 * fit.cost_before


def test_what_does_not_fit_bends_the_first_round_alone() -> None:
    rng, points = scene(8, 60)
    camera, point = (part.ravel() for part in np.mgrid[:3, :60])
    poses = np.stack([TRUTH, *(pose([0.02 * i, 0.03, 0.01], [0.2 * i, 0, 0]) for i in (1, 2))])
    measured = np.concatenate([pixels(T, points) for T in poses])
    measured[rng.random(180) < 0.05, 0] += 25
    start = poses.copy()
    start[0] = pose([0.005, 0, 0], [0.01, 0, 0]) @ TRUTH
    problem = start, 1, points, camera, point, measured, np.ones(180)
    one, two = (adjust_bundle(CAMERA, GATES, *problem, rounds, 10) for rounds in (1, 2))
    off_by_one, off_by_two = (np.abs(fit.T_camera_map[0] - TRUTH).max() for fit in (one, two))
    assert off_by_one > 1e-4
    assert off_by_two < 1e-6


def test_a_point_between_fixed_cameras_is_their_least_squares() -> None:
    """The result equals that of SciPy, so that derivatives by the point and weights are right."""
    rng = np.random.default_rng(6)
    point = np.array([0.3, -0.2, 2.5])
    poses = np.stack([pose([0.02 * i, -0.05 * i, 0.01], [0.1 * i, 0.02, 0.0]) for i in range(4)])
    measured = np.concatenate([pixels(T, point[None]) for T in poses])
    measured += rng.normal(0, 0.3, measured.shape)
    measured[1, 2] = np.nan
    weight = np.array([1.0, 0.5, 0.25, 0.7])

    def residuals(at: FloatArray) -> FloatArray:
        seen = np.concatenate([pixels(T, at[None]) for T in poses]) - measured
        disparity = measured[:, 0] - measured[:, 2]
        noise = np.hypot(CAMERA.disparity_noise_px, CAMERA.relative_noise * disparity)
        rows = [
            seen[:, :2] * np.sqrt(weight)[:, None],
            ((seen[:, 0] - seen[:, 2]) / noise)[:, None],
        ]
        return np.asarray(np.nan_to_num(np.concatenate(rows, 1)).ravel())

    best = least_squares(residuals, point, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    fit = adjust_bundle(
        CAMERA, GATES, poses, 0, point[None] + 0.05, np.arange(4), np.zeros(4, int), measured,
        weight, 2, 30,
    )  # fmt: skip
    np.testing.assert_allclose(fit.points_m[0], best.x, atol=2e-5)
    assert fit.cost_after == pytest.approx(2 * best.cost, rel=1e-4)


def test_kernels_are_as_wide_as_the_noise() -> None:
    """Errors of 2 px have less weight for a camera whose pixel noise is 0.1 px."""
    _, points = scene(4, 100)
    measured = pixels(TRUTH, points)
    measured[:20, 0] += 2.0
    measured[:, 2] = np.nan
    errors = []
    for noise in (1.0, 0.1):
        camera = stereo(pixel_noise=noise)
        fit = optimize_pose(camera, GATES, points, measured, np.ones(100), TRUTH)
        assert fit.inliers.all()
        errors.append(np.linalg.norm(fit.T_camera_map - TRUTH))
    assert errors[1] < 0.3 * errors[0]


def test_only_the_ratio_of_pixel_and_depth_noise_matters_where_all_fits() -> None:
    _, points = scene(5, 60)
    measured = pixels(TRUTH, points)
    halved = stereo(
        pixel_noise=0.5,
        disparity_noise_px=0.5 * CAMERA.disparity_noise_px,
        relative_noise=0.5 * CAMERA.relative_noise,
    )
    one, other = (
        optimize_pose(camera, GATES, points, measured, np.ones(60), TRUTH)
        for camera in (CAMERA, halved)
    )
    np.testing.assert_allclose(one.information, other.information, rtol=1e-9)
