"""Which of two camera motions explains the image: area, and earlier depth where it is asked."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import CameraModel, FloatArray
from hoid_filter.motion.depth_history import DepthHistory, widened
from hoid_filter.motion.downscaled_camera import DownscaledCamera, DownscaledView
from hoid_filter.motion.ego_motion import EgoMotion, PointObservations
from hoid_native import depth_segments

CAMERA = DownscaledCamera(CameraModel(320, 240, 260.0, 260.0, 159.5, 119.5))
STILL, GUESSES = np.zeros(3), [np.eye(4)]
T_ROOM = se3.exp(np.array([0.0, 0.01, 0.0, 0.02, 0.0, 0.0]))  # T_camera_world of the image
T_SCREEN = se3.exp(np.array([0.02, -0.02, 0.0, -0.1, 0.05, 0.0]))  # as the screen shows it


def two_motions(share_of_screen: float) -> PointObservations:
    """Return points of a room and of a screen with a moving picture, of equal areas."""
    rng = np.random.default_rng(5)
    count = 300
    is_screen = np.arange(count) < share_of_screen * count
    world_m = rng.uniform([-1.0, -0.8, 1.5], [1.0, 0.8, 4.0], (count, 3))
    world_m[is_screen, 2] = 1.5
    camera_m = np.where(
        is_screen[:, None], se3.transform(T_SCREEN, world_m), se3.transform(T_ROOM, world_m)
    )
    pinhole = CAMERA.gray_pinhole
    u = camera_m[:, 0] / camera_m[:, 2] * pinhole.fx_px + pinhole.cx_px
    v = camera_m[:, 1] / camera_m[:, 2] * pinhole.fy_px + pinhole.cy_px
    right = u - CAMERA.disparity_px_m / camera_m[:, 2]
    return PointObservations(
        world_m=world_m,
        observed_px=np.stack([u, v, right], axis=1),
        camera_m=camera_m,
        has_depth=np.ones(count, np.bool_),
        region=is_screen.astype(np.int64),
        static_probability=np.ones(count),
        weights=np.ones((count, 2)),
    )


def contradicts(T_camera_world: FloatArray) -> float:
    """Return the contradiction of a depth camera that knows the room's motion."""
    apart_m = np.linalg.norm(T_camera_world[:3, 3] - T_ROOM[:3, 3])
    return 0.05 if apart_m > 0.03 else 0.002


@pytest.mark.parametrize('share', [0.3, 0.7])
def test_the_pose_that_explains_most_area_is_chosen(share: float) -> None:
    found = EgoMotion(CAMERA).estimate(two_motions(share), GUESSES)
    expected = T_SCREEN if share > 0.5 else T_ROOM
    np.testing.assert_allclose(found.T_camera_world, expected, atol=2e-3)
    assert found.ratio == pytest.approx(max(share, 1 - share), abs=0.1)


@pytest.mark.parametrize('share', [0.3, 0.7])
def test_earlier_depth_decides_between_two_motions(share: float) -> None:
    found = EgoMotion(CAMERA).estimate(two_motions(share), GUESSES, contradicts)
    np.testing.assert_allclose(found.T_camera_world, T_ROOM, atol=2e-3)
    assert found.contradicts_prior == (share > 0.5)


@pytest.mark.parametrize('equal', [0.0, 0.05])
def test_depth_that_contradicts_both_motions_alike_does_not_decide(equal: float) -> None:
    found = EgoMotion(CAMERA).estimate(two_motions(0.7), GUESSES, lambda _: equal)
    np.testing.assert_allclose(found.T_camera_world, T_SCREEN, atol=2e-3)


def box_before_a_wall(stamp_s: float) -> DownscaledView:
    """Return a view of a wall at 3 m, before which a box of 40 x 40 px stands at 1 m."""
    depth_m = np.full(CAMERA.shape_hw, 3.0, np.float32)
    depth_m[40:80, 60:100] = 1.0
    gray = np.zeros((240, 320), np.uint8)
    return DownscaledView(stamp_s, gray, depth_m, depth_segments(depth_m, 20))


def test_a_wrong_pose_moves_surface_in_front_of_earlier_depth() -> None:
    history = DepthHistory(CAMERA)
    assert history.contradiction(box_before_a_wall(0.0), np.eye(4)) == 0.0  # nothing to compare
    history.add(box_before_a_wall(0.0), np.eye(4), STILL)
    view = box_before_a_wall(0.4)
    assert history.contradiction(view, np.eye(4)) == 0.0
    # At 130 px focal length and 1 m, 0.1 m are 13 px, of which 1 is within the neighborhood.
    shifted = se3.exp(np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0]))
    strip = 12 * 40 / view.depth_m.size
    assert history.contradiction(view, shifted) == pytest.approx(strip, rel=0.15)


def test_depth_ranges_cover_three_by_three_pixels() -> None:
    rng = np.random.default_rng(2)
    depth_m = rng.uniform(1, 4, (30, 37)).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.6] = 0.0
    found = widened(np.stack([depth_m, depth_m], axis=2), 1)
    for v, u in np.ndindex(depth_m.shape):
        near = depth_m[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2]
        expected = (near[near > 0].min(), near.max()) if depth_m[v, u] > 0 else (0, 0)
        assert tuple(found[v, u]) == expected
