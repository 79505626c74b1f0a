"""Rolling shutter, repeated color images and fast cameras in rendered scenes."""

from dataclasses import replace

import numpy as np
import pytest

from hoid_common import se3
from hoid_synth.acting.camera_path import camera_poses
from hoid_synth.acting.stage import set_stage
from hoid_synth.config import SceneConfig
from hoid_synth.scene import SceneRenderer
from hoid_synth.static_model import StaticModel

TURNING = SceneConfig(seed=3, num_frames=40, width_px=160, num_people=0, path='rpy', pace=3.0)
SHUTTER_S = 0.03
N = 20


@pytest.mark.slow
def test_each_row_is_seen_from_the_pose_at_its_time() -> None:
    config = replace(TURNING, shutter_s=SHUTTER_S)
    renderer = SceneRenderer(config)
    depth_m = renderer.frame(N).true_depth_m.astype(float)
    camera, height = config.camera, config.height_px
    v, u = np.mgrid[0:height, 0 : config.width_px]
    rays = np.stack([(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px], -1)
    points_m = np.concatenate([rays, np.ones_like(rays[..., :1])], -1) * depth_m[..., None]
    offset_s = SHUTTER_S * ((np.arange(height) + 0.5) / height - 0.5)
    of_row = camera_poses(config, config.pace * (config.start_s + config.time_s(N) + offset_s))
    T, velocity = renderer.stage.T_world_camera[N], renderer.stage.velocity(N)
    at_constant_velocity = T @ se3.exp(offset_s[:, None] * velocity)
    of_image = np.repeat(T[None], height, 0)
    model = StaticModel(renderer.stage)

    def errors_m(T_rows: np.ndarray) -> np.ndarray:
        seen = [se3.transform(T_row, row) for T_row, row in zip(T_rows, points_m, strict=True)]
        return model.distance_m(np.concatenate(seen))

    assert errors_m(at_constant_velocity).max() < 1e-4
    assert errors_m(of_row).max() < 0.003
    assert np.percentile(errors_m(of_image), 90) > 0.01


@pytest.mark.slow
def test_without_rows_in_time_the_shutter_changes_nothing() -> None:
    plain, short = (
        SceneRenderer(TURNING).frame(N),
        SceneRenderer(replace(TURNING, shutter_s=1e-9)).frame(N),
    )
    np.testing.assert_allclose(plain.true_depth_m, short.true_depth_m, atol=1e-4)


@pytest.mark.slow
def test_color_images_repeat_and_depth_images_are_new() -> None:
    config = replace(TURNING, color_every=2)
    frames = [SceneRenderer(config).frame(i).frame for i in (N, N + 1, N + 2)]
    assert np.array_equal(frames[0].image_bgr, frames[1].image_bgr)
    assert not np.array_equal(frames[1].image_bgr, frames[2].image_bgr)
    assert not np.array_equal(frames[0].depth_m, frames[1].depth_m)
    own = SceneRenderer(TURNING).frame(N + 1).frame
    assert np.array_equal(frames[1].depth_m, own.depth_m)


def test_the_pace_is_a_factor_of_the_speed() -> None:
    slow, fast = set_stage(replace(TURNING, pace=1.0)), set_stage(replace(TURNING, pace=2.0))
    np.testing.assert_allclose(
        fast.T_world_camera[:10], slow.T_world_camera[:20:2], rtol=0, atol=1e-12
    )


@pytest.mark.slow
def test_the_exposure_swings_by_its_amplitude() -> None:
    def brightness(swing: float) -> list[float]:
        renderer = SceneRenderer(replace(TURNING, path='static', exposure_swing=swing))
        return [float(renderer.frame(i).frame.image_bgr.mean()) for i in (0, 39)]

    still, changing = brightness(0.0), brightness(0.4)
    assert abs(still[1] / still[0] - 1) < 0.02
    assert abs(changing[1] / changing[0] - 1) > 0.05
