"""Sensor model of an RGB-D camera: blur and noise; quantization and holes in depth."""

from __future__ import annotations

import cv2
import numpy as np

from hoid_common.values import BoolArray, ByteArray, Float32Array
from hoid_synth.config import SceneConfig
from hoid_synth.noise import Rng

EXPOSURE_S = 0.011
MIN_DEPTH_M, MAX_DEPTH_M = 0.4, 8.0
_LENS_SIGMA_PX = 0.5
_READ_NOISE, _SHOT_NOISE = 1.3, 0.11  # in gray levels; per square root of the gray level
_PROJECTOR_BASELINE_M = 0.075
_DISPARITY_STEP_PX = 0.125
_GRAZING_COSINE = 0.16
_MAX_SAMPLES = 9
# A phone's LiDAR, up to 5 m: points this far apart at VGA, interpolated, with a noise that is a
# share of depth. Chosen, not measured.
_LIDAR_STEP_PX, _LIDAR_MAX_M, _LIDAR_NOISE_SHARE = 8, 5.0, 0.003


def motion_blurred(image: Float32Array, flow_px: Float32Array) -> Float32Array:
    """Return the image blurred along the image motion (H, W, 2) during the exposure in px."""
    length = float(np.percentile(np.abs(flow_px[::8, ::8]), 99))
    samples = min(_MAX_SAMPLES, int(np.ceil(length)) + 1)
    if samples < 2:
        return image
    height, width = image.shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    total = np.zeros_like(image)
    for share in np.linspace(-0.5, 0.5, samples, dtype=np.float32):
        at_x, at_y = x + share * flow_px[..., 0], y + share * flow_px[..., 1]
        total += cv2.remap(image, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return total / np.float32(samples)


def color_image(
    image: Float32Array, flow_px: Float32Array, config: SceneConfig, rng: Rng
) -> ByteArray:
    """Return the color image (H, W, 3) with lens and motion blur, shot and read noise."""
    soft = cv2.GaussianBlur(image, (0, 0), max(_LENS_SIGMA_PX * config.scale, 0.3))
    out = motion_blurred(np.asarray(soft, np.float32), flow_px)
    out = np.clip(out, 0, 255)
    sigma = np.float32(_READ_NOISE) + np.float32(_SHOT_NOISE) * np.sqrt(out)
    out += np.float32(config.color_noise) * sigma * rng.standard_normal(out.shape, np.float32)
    return np.asarray(np.clip(out + 0.5, 0, 255).astype(np.uint8))


def depth_image(
    depth_m: Float32Array,
    cosine: Float32Array,
    ir_dark: Float32Array,
    config: SceneConfig,
    rng: Rng,
) -> Float32Array:
    """Return the measured depth image (H, W) in m, quantized to millimeters.

    Noise grows with the square of depth (Nguyen et al., 2012) and is correlated between neighbors.
    Disparity has steps of an eighth of a pixel. Depth is missing in the shadow of the projector.

    Args:
        depth_m: (H, W) true depth, inf without a surface.
        cosine: (H, W) cosine of the angle between line of sight and surface normal.
        ir_dark: (H, W) share of readings lost on dark and shiny surfaces.
        config: Scale of the noise, and whether there are holes.
        rng: Random number generator.
    """
    if config.smooth_depth:
        return _lidar_depth(depth_m, config, rng)
    shape = depth_m.shape
    z = np.minimum(_ragged(depth_m, config, rng), np.float32(1e3))
    blotches = cv2.resize(
        rng.standard_normal((shape[0] // 3 + 1, shape[1] // 3 + 1), np.float32), shape[::-1]
    )
    noise = np.float32(1.1) * blotches + np.float32(0.5) * rng.standard_normal(shape, np.float32)
    spread = np.float32(config.depth_noise) * (
        np.float32(0.0008) + np.float32(0.0017) * (z - np.float32(0.4)) ** 2
    )
    read = np.maximum(z + np.minimum(spread, np.float32(0.08)) * noise, np.float32(0.1))
    # The disparity of the sensor does not depend on the image size.
    focal_baseline = np.float32(525.0 * _PROJECTOR_BASELINE_M)
    if config.depth_noise > 0:
        step = np.float32(_DISPARITY_STEP_PX)
        read = focal_baseline / (np.round(focal_baseline / read / step) * step)
    invalid = (depth_m < MIN_DEPTH_M) | (depth_m > MAX_DEPTH_M)
    if config.depth_holes:
        invalid |= _holes(depth_m, cosine, ir_dark, config, rng)
    read = np.round(read * np.float32(1000))
    read[invalid] = 0
    return np.asarray(read / np.float32(1000), np.float32)


def _lidar_depth(depth_m: Float32Array, config: SceneConfig, rng: Rng) -> Float32Array:
    """Return depth (H, W) as a phone computes it from few LiDAR points, in whole millimeters."""
    height, width = depth_m.shape
    step = max(1, round(_LIDAR_STEP_PX * config.scale))
    few = (width // step, height // step)
    near = cv2.resize(np.minimum(depth_m, np.float32(20)), few, interpolation=cv2.INTER_AREA)
    noise = np.float32(_LIDAR_NOISE_SHARE * config.depth_noise)
    near = near * (1 + noise * rng.standard_normal(near.shape, np.float32))
    smooth = cv2.GaussianBlur(near, (3, 3), 0)
    read = cv2.resize(smooth, (width, height), interpolation=cv2.INTER_LINEAR)
    read[(read < MIN_DEPTH_M) | (read > _LIDAR_MAX_M)] = 0
    return np.asarray(np.round(read * np.float32(1000)) / np.float32(1000), np.float32)


def _ragged(depth_m: Float32Array, config: SceneConfig, rng: Rng) -> Float32Array:
    """Return depth sampled up to a pixel away, because edges in real depth images are uneven."""
    if config.depth_noise == 0:
        return depth_m
    shift = rng.integers(-1, 2, (2, *depth_m.shape), np.int8)
    shift[:, rng.random(depth_m.shape, np.float32) < 0.45] = 0
    rows, columns = depth_m.shape
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    index = index + shift[0] * np.int32(columns) + shift[1]
    return np.asarray(depth_m.ravel()[np.clip(index, 0, rows * columns - 1)])


def _holes(
    depth_m: Float32Array,
    cosine: Float32Array,
    ir_dark: Float32Array,
    config: SceneConfig,
    rng: Rng,
) -> BoolArray:
    """Return a mask (H, W) of pixels without a reading."""
    dots = cv2.resize(
        rng.random((depth_m.shape[0] // 2 + 1, depth_m.shape[1] // 2 + 1), np.float32),
        depth_m.shape[::-1],
    )
    grazing = cosine < np.float32(_GRAZING_COSINE) * (np.float32(0.6) + np.float32(0.8) * dots)
    lost = dots < ir_dark + np.float32(0.0008)
    return np.asarray(grazing | lost | shadowed(depth_m, config))


def shadowed(depth_m: Float32Array, config: SceneConfig) -> BoolArray:
    """Return a mask (H, W) of surfaces occluded from the projector, right of the camera."""
    reach_px = np.float32(config.camera.fx_px * _PROJECTOR_BASELINE_M)
    column = np.arange(depth_m.shape[1], dtype=np.float32)
    # Column in the view of the projector.
    seen_at = column - reach_px / np.maximum(depth_m, np.float32(0.05))
    nearest_left = np.minimum.accumulate(seen_at[:, ::-1], axis=1)[:, ::-1]
    behind = np.roll(nearest_left, -1, axis=1)
    behind[:, -1] = np.inf
    return np.asarray(seen_at > behind + np.float32(0.3))
