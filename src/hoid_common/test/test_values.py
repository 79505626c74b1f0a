from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from hoid_common.errors import ConfigError, MessageError
from hoid_common.inputs.input_watch import InputWatch
from hoid_common.log_throttle import LogThrottle
from hoid_common.values import CameraModel, Detections, DynamicObject, Features, ObjectState

DISTORTION = (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)
THIN_PRISM_AND_TILT = (0.002, -0.001, 0.003, 0.001, 0.01, -0.02)


def camera(distortion: tuple[float, ...] = ()) -> CameraModel:
    return CameraModel(640, 480, 517.3, 516.5, 318.6, 255.3, distortion)


def test_camera_matrix() -> None:
    np.testing.assert_array_equal(
        camera().matrix, [[517.3, 0, 318.6], [0, 516.5, 255.3], [0, 0, 1]]
    )


def test_projection_of_known_points() -> None:
    points = np.array([[0, 0, 2.0], [1, 0, 2], [0, -1, 4]])
    np.testing.assert_allclose(
        camera().project_px(points),
        [[318.6, 255.3], [318.6 + 517.3 / 2, 255.3], [318.6, 255.3 - 516.5 / 4]],
        rtol=1e-6,
    )


def test_undistortion_inverts_projection() -> None:
    points = np.random.default_rng(0).uniform([-0.8, -0.6, 2], [0.8, 0.6, 3], (50, 3))
    imaged = camera(DISTORTION).project_px(points)
    ideal = camera().project_px(points)
    assert np.abs(imaged - ideal).max() > 0.5
    np.testing.assert_allclose(
        camera(DISTORTION).undistort_px(imaged.astype(np.float32)), ideal, atol=0.02
    )


@pytest.mark.parametrize('num_coefficients', [4, 5, 8, 12, 14])
def test_distortion_equals_that_of_opencv(num_coefficients: int) -> None:
    bent = camera((*DISTORTION, 0.11, -0.07, 0.02, *THIN_PRISM_AND_TILT)[:num_coefficients])
    points = np.random.default_rng(0).uniform([-1.5, -1, 1.5], [1.5, 1, 4], (50, 3))
    zero = np.zeros(3)
    expected, _ = cv2.projectPoints(points, zero, zero, bent.matrix, np.array(bent.distortion))
    np.testing.assert_allclose(bent.project_px(points), expected[:, 0], rtol=0, atol=1e-9)


def test_equidistant_distortion_equals_that_of_opencv() -> None:
    bent = replace(camera((0.1, -0.05, 0.02, -0.01)), is_fisheye=True)
    assert bent.distortion_model == 'equidistant'
    points = np.random.default_rng(0).uniform([-1.5, -1, 1.5], [1.5, 1, 4], (50, 3))
    zero = np.zeros(3)
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], zero, zero, bent.matrix, np.array(bent.distortion)
    )
    imaged = bent.project_px(points)
    np.testing.assert_allclose(imaged, expected[:, 0], rtol=0, atol=1e-9)
    ideal = replace(bent, distortion=()).project_px(points)
    found = bent.undistort_px(imaged.astype(np.float32))
    np.testing.assert_allclose(found, ideal, atol=0.01)
    with pytest.raises(ConfigError, match='up to 4 numbers'):
        replace(bent, distortion=(0.1,) * 5)


def test_undistortion_without_distortion_returns_its_input() -> None:
    uv = np.zeros((3, 2), np.float32)
    assert camera().undistort_px(uv) is uv


@pytest.mark.parametrize(
    'bad',
    [
        {'fx_px': 0.0},
        {'fx_px': 1e-300},
        {'fy_px': 1e5},
        {'fy_px': float('nan')},
        {'cx_px': float('inf')},
        {'cy_px': -1000.0},
        {'width_px': 0},
        {'width_px': 100_000, 'height_px': 100_000},
        {'height_px': 2**31 - 1},
        {'distortion': (1e20,)},
    ],
)
def test_impossible_cameras_are_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r'camera .* must be .*, got'):
        replace(camera(DISTORTION), **bad)


@pytest.mark.parametrize('bad', [(0.1,) * 15, (float('nan'),)])
def test_unsupported_distortion_is_refused(bad: tuple[float, ...]) -> None:
    with pytest.raises(ConfigError, match='distortion must be up to 14 numbers'):
        camera(bad)


def test_too_long_class_names_are_refused() -> None:
    detections([[0, 0, 1, 1]], [0.5], ['x' * 100])
    with pytest.raises(MessageError, match='a class name has 101 characters, more than 100'):
        detections([[0, 0, 1, 1]], [0.5], ['x' * 101])


def test_missing_coefficients_equal_zero() -> None:
    pixels = np.random.default_rng(0).uniform(0, 480, (50, 2)).astype(np.float32)
    expected = camera((0.1, -0.2, 0, 0, 0)).undistort_px(pixels)
    for distortion in ((0.1, -0.2), (0.1, -0.2, *(0,) * 12)):
        np.testing.assert_array_equal(camera(distortion).undistort_px(pixels), expected)


def detections(
    xyxy: Sequence[Sequence[float]], scores: Sequence[float], names: Sequence[str] | None = None
) -> Detections:
    return Detections(
        7,
        np.array(xyxy, np.float32).reshape(-1, 4),
        tuple(names or ['person'] * len(scores)),
        np.array(scores, np.float32),
    )


def test_detections_of_different_lengths_are_refused() -> None:
    with pytest.raises(MessageError, match='1 classes'):
        detections([[0, 0, 1, 1]], [0.5, 0.5], ['person'])


def test_no_detections() -> None:
    none = Detections.none(3)
    assert (len(none), none.stamp_ns, none.boxes_xyxy_px.shape) == (0, 3, (0, 4))


def features(n: int) -> Features:
    return Features(
        5,
        np.arange(2 * n, dtype=np.float32).reshape(n, 2),
        np.ones(n, np.float32),
        np.zeros(n, np.uint8),
        np.zeros(n, np.float32),
        np.arange(n, dtype=np.float32),
        np.zeros((n, 32), np.uint8),
        np.ones(n, np.bool_),
    )


def test_select_keeps_the_arrays_of_a_feature_together() -> None:
    chosen = features(4).select(np.array([False, True, False, True]))
    np.testing.assert_array_equal(chosen.response, [1, 3])
    np.testing.assert_array_equal(chosen.uv_px, [[2, 3], [6, 7]])
    assert chosen.stamp_ns == 5


def test_features_of_different_lengths_are_refused() -> None:
    good = features(3)
    with pytest.raises(MessageError, match=r'depth_m has shape \(2,\), expected \(3,\)'):
        Features(
            0,
            good.uv_px,
            good.depth_m[:2],
            good.octave,
            good.angle_deg,
            good.response,
            good.descriptors,
            good.may_seed,
        )


@pytest.mark.parametrize('state', ObjectState)
def test_all_objects_but_those_at_rest_are_dynamic(state: ObjectState) -> None:
    obj = DynamicObject('cup', (0, 0, 1, 1), 0.5, -1, state)
    assert obj.is_dynamic == (state not in (ObjectState.AT_REST, ObjectState.MOVED))


def test_throttle_counts_suppressed_messages() -> None:
    throttle = LogThrottle(5.0)
    assert throttle.allow('a', 0.0) == 0
    assert throttle.allow('a', 1.0) is None
    assert throttle.allow('b', 1.0) == 0
    assert throttle.allow('a', 4.9) is None
    assert throttle.allow('a', 5.0) == 2
    assert throttle.allow('a', 20.0) == 0


def test_text_about_a_missing_input() -> None:
    watch = InputWatch('depth images', '/depth/image', 'reliable', since_s=100.0)
    assert not watch.is_missing(101.0)
    assert watch.is_missing(103.2)
    assert watch.missing_message(103.2, []) == (
        'no depth images yet for 3.2 s on /depth/image: no publisher'
    )
    watch.record_message(104.0)
    assert not watch.is_missing(105.0)
    assert watch.missing_message(107.2, ['best_effort']) == (
        'no depth images for 3.2 s on /depth/image: 1 publisher, reliability best_effort, '
        'but the subscription requests reliable'
    )
    assert '2 publishers, reliability best_effort, reliable,' in watch.missing_message(
        110.0, ['reliable', 'best_effort']
    )
    assert watch.missing_message(110.0, ['reliable'] * 2).endswith('/image: 2 publishers, silent')


@pytest.mark.parametrize('offered', ['reliable', 'best_effort'])
def test_a_best_effort_subscription_matches_every_publisher(offered: str) -> None:
    watch = InputWatch('images', '/image', 'best_effort', since_s=0.0)
    assert (
        watch.missing_message(3.0, [offered])
        == 'no images yet for 3.0 s on /image: 1 publisher, silent'
    )
