from typing import Any

import numpy as np
import pytest

from hoid_common.errors import ConfigError
from hoid_synth.config import SceneConfig
from hoid_synth.render import sensor

SHAPE = (120, 160)
SMALL = SceneConfig(width_px=160)
FACING = np.ones(SHAPE, np.float32)
NOT_DARK = np.zeros(SHAPE, np.float32)


def read(depth_m: float, config: SceneConfig = SMALL) -> np.ndarray:
    flat = np.full(SHAPE, depth_m, np.float32)
    return sensor.depth_image(flat, FACING, NOT_DARK, config, np.random.default_rng(0))


def test_depth_is_in_whole_millimeters() -> None:
    millimeters = read(2.0) * 1000
    np.testing.assert_allclose(millimeters, np.rint(millimeters), atol=1e-3)


def test_depth_noise_grows_with_the_square() -> None:
    spread = [float(read(z)[read(z) > 0].std()) for z in (1.0, 2.0, 4.0)]
    assert spread[0] < 0.004
    assert 2.5 < spread[2] / spread[1] < 6
    assert abs(float(read(2.0)[read(2.0) > 0].mean()) - 2.0) < 0.003


def test_nothing_is_read_too_near_and_too_far() -> None:
    assert not read(0.3).any()
    assert not read(9.0).any()


def test_perfect_sensor_reads_the_truth() -> None:
    perfect = SceneConfig(width_px=160, depth_noise=0.0, depth_holes=False)
    np.testing.assert_allclose(read(2.3456, perfect), 2.346, atol=1e-6)


def test_depth_of_a_phone_has_no_holes_and_wide_edges() -> None:
    phone = SceneConfig(smooth_depth=True)
    step = np.full((480, 640), 3.0, np.float32)
    step[:, 320:] = 1.5
    cosine, dark = np.full_like(step, 0.05), np.ones_like(step)
    read = sensor.depth_image(step, cosine, dark, phone, np.random.default_rng(0))
    assert (read > 0).all()
    between = (read[240] > 1.6) & (read[240] < 2.9)
    assert 8 <= np.count_nonzero(between) <= 20
    assert abs(float(read[:, :300].mean()) - 3.0) < 0.003
    assert not sensor.depth_image(
        0 * step + 6, cosine, dark, phone, np.random.default_rng(0)
    ).any()


def test_a_near_thing_throws_a_shadow_to_its_left() -> None:
    depth = np.full(SHAPE, 3.0, np.float32)
    depth[:, 80:100] = 1.0
    width = SMALL.camera.fx_px * 0.075 * (1 - 1 / 3)  # disparity difference
    hidden = sensor.shadowed(depth, SMALL)[60]
    assert hidden.sum() == pytest.approx(width, abs=1.5)
    assert hidden[79]
    assert not hidden[80:].any()


def test_motion_blur_smears_along_the_flow_only() -> None:
    image = np.zeros((40, 40, 3), np.float32)
    image[20, 20] = 100
    flow = np.zeros((40, 40, 2), np.float32)
    flow[..., 0] = 4
    out = sensor.motion_blurred(image, flow)[..., 0]
    assert out[20, 18:23].sum() == pytest.approx(100, rel=0.1)
    assert not out[19].any()
    assert out[20, 20] < 30


def test_color_noise_has_the_stated_size() -> None:
    gray = np.full((200, 200, 3), 100, np.float32)
    still = np.zeros((200, 200, 2), np.float32)
    noisy = sensor.color_image(gray, still, SMALL, np.random.default_rng(0)).astype(float)
    assert noisy.mean() == pytest.approx(100, abs=0.2)
    assert noisy.std() == pytest.approx(1.3 + 0.11 * 10, rel=0.1)


@pytest.mark.parametrize(
    'bad', [{'num_frames': -1}, {'path': 'spiral'}, {'num_people': 7}, {'width_px': 10}]
)
def test_bad_settings_are_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=next(iter(bad))):
        SceneConfig(**bad)
