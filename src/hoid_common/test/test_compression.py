"""Compressed images of every plugin of image_transport: right, or one line."""

from __future__ import annotations

import struct
import time
import tracemalloc
from contextlib import suppress
from typing import Any

import cv2
import numpy as np
import pytest

from hoid_common.errors import MessageError
from hoid_common.io.compression.compressed_images import (
    compressed_head,
    decode_compressed_color,
    decode_compressed_depth,
)
from hoid_common.io.compression.rvl import decode_rvl

from .packed_images import quantized, rvl, zstd_image

RNG = np.random.default_rng(0)
DEPTH_MM = np.where(RNG.random((48, 64)) < 0.3, 0, RNG.integers(300, 9000, (48, 64)))
DEPTH_MM = DEPTH_MM.astype(np.uint16)
DEPTH_M = (DEPTH_MM / 1000).astype(np.float32)
COLOR = RNG.integers(0, 256, (48, 64, 3)).astype(np.uint8)


def tiff(pixels: Any) -> bytes:
    return cv2.imencode('.tiff', pixels)[1].tobytes()


@pytest.mark.parametrize(
    ('format_', 'data', 'error_m'),
    [
        ('16UC1; compressedDepth rvl', bytes(12) + rvl(DEPTH_MM), 0),
        ('32FC1; compressedDepth rvl', quantized(DEPTH_M)[0] + rvl(quantized(DEPTH_M)[1]), 0.005),
        ('zstd', zstd_image(DEPTH_MM, '16UC1'), 0),
        ('zstd', zstd_image(DEPTH_MM, '16UC1', as_gzip=True), 0),
        ('zstd', zstd_image(DEPTH_M, '32FC1', as_gzip=True), 0),
        ('16UC1; tiff compressed ', tiff(DEPTH_MM), 0),
        ('32FC1; tiff compressed ', tiff(DEPTH_M), 0),
    ],
    ids=['rvl', 'rvl float', 'zstd', 'zstd of Jazzy', 'zstd float', 'tiff', 'tiff float'],
)
def test_depth_of_every_plugin_is_right(format_: str, data: bytes, error_m: float) -> None:
    depth_m = decode_compressed_depth(format_, data)
    np.testing.assert_allclose(depth_m, DEPTH_M, atol=error_m, rtol=error_m)
    encoding, size_px = compressed_head(format_, data)
    assert encoding in ('16UC1', '32FC1')
    assert size_px == (64, 48)


@pytest.mark.parametrize(
    ('format_', 'data'),
    [
        ('zstd', zstd_image(COLOR, 'bgr8')),
        ('zstd', zstd_image(COLOR[..., ::-1], 'rgb8', as_gzip=True)),
        ('bgr8; tiff compressed bgr8', tiff(COLOR)),
    ],
)
def test_color_of_every_plugin_is_right(format_: str, data: bytes) -> None:
    np.testing.assert_array_equal(decode_compressed_color(data, format_), COLOR)
    encoding, size_px = compressed_head(format_, data)
    assert encoding in ('bgr8', 'rgb8')
    assert size_px == (64, 48)


@pytest.mark.parametrize('pixels', [np.zeros((3, 5)), np.full((3, 5), 65535), np.eye(5) * 7])
def test_rvl_of_runs_is_right(pixels: Any) -> None:
    np.testing.assert_array_equal(decode_rvl(rvl(pixels.astype(np.uint16))), pixels)


def test_rvl_of_a_vga_image_is_fast() -> None:
    smooth = np.tile(np.arange(640) * 3 + 900, (480, 1)) + RNG.integers(0, 20, (480, 640))
    data = rvl(np.where(RNG.random((480, 640)) < 0.02, 0, smooth).astype(np.uint16))
    start_s = time.process_time()
    decode_rvl(data)
    assert time.process_time() - start_s < 0.3  # measured: 0.02 s


@pytest.mark.parametrize('length', [0, 4, 8, 12, 40, 400])
def test_rvl_that_is_cut_off_is_refused(length: int) -> None:
    with pytest.raises(MessageError, match='RVL image'):
        decode_rvl(rvl(DEPTH_MM)[:length])


def test_rvl_of_noise_is_refused_or_of_the_claimed_size() -> None:
    for seed in range(50):
        noise = np.random.default_rng(seed).integers(0, 256, 500, np.uint8).tobytes()
        with suppress(MessageError):
            assert decode_rvl(struct.pack('<II', 8, 6) + noise).shape == (6, 8)


@pytest.mark.parametrize(
    ('data', 'expected'),
    [
        (b'', 'has 0 bytes'),
        (struct.pack('<IIBII', 2**30, 2**30, 0, 8, 5) + b'16UC1', 'claims to be'),
        (struct.pack('<IIBII', 4, 4, 0, 2**31, 5) + b'16UC1', 'at step 2147483648'),
        (struct.pack('<IIBII', 4, 4, 0, 8, 2**31) + b'16UC1', 'no encoding'),
        (zstd_image(DEPTH_MM, '16UC1')[:-30], 'unpacked|bytes, but 64x48'),
        (zstd_image(DEPTH_MM, '16UC1')[:30] + b'x' * 50, 'cannot be unpacked'),
        (zstd_image(DEPTH_MM, '16UC1', as_gzip=True)[:60], 'bytes, but 64x48'),
        (zstd_image(COLOR, 'bgr8'), 'depth image has encoding "bgr8"'),
    ],
)
def test_zstd_images_that_are_damaged_are_refused(data: bytes, expected: str) -> None:
    with pytest.raises(MessageError, match=expected):
        decode_compressed_depth('zstd', data)


def test_a_zstd_image_cannot_fill_the_memory() -> None:
    bomb = zstd_image(np.zeros((10_000, 10_000), np.uint8), 'mono8')
    small = struct.pack('<IIBII', 48, 64, 0, 64, 5) + bomb[17:]
    tracemalloc.start()
    decode_compressed_color(small, 'zstd')
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


@pytest.mark.parametrize('format_', ['h264', 'mystery'])
def test_a_format_that_is_not_read_is_named(format_: str) -> None:
    data = b'\0\0\0\1\x67' + bytes(50)
    with pytest.raises(MessageError, match=f'format "{format_}" .* is not a readable JPEG, PNG'):
        decode_compressed_color(data, format_)
    with pytest.raises(MessageError, match=f'compressed depth has format "{format_}"'):
        decode_compressed_depth(format_, data)


@pytest.mark.parametrize('size', [8, 50, 200])
def test_a_tiff_that_is_cut_off_is_refused(size: int) -> None:
    with pytest.raises(MessageError):
        decode_compressed_depth('16UC1; tiff compressed ', tiff(DEPTH_MM)[:size])
