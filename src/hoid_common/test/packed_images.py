"""Images packed as the plugins of image_transport pack them, written from their formats."""

from __future__ import annotations

import gzip
import struct
from typing import Any

import numpy as np
from backports import zstd
from numpy.typing import NDArray


def rvl(pixels: NDArray[np.uint16]) -> bytes:
    """Return the RVL image of (H, W) uint16 pixels."""
    groups: list[int] = []

    def put(number: int) -> None:
        while True:
            number, low = number >> 3, number & 7
            groups.append(low | (8 if number else 0))
            if not number:
                return

    flat, at, before = pixels.ravel().astype(int).tolist(), 0, 0
    while at < len(flat):
        start = at
        while at < len(flat) and flat[at] == 0:
            at += 1
        put(at - start)
        start = at
        while at < len(flat) and flat[at] != 0:
            at += 1
        put(at - start)
        for value in flat[start:at]:
            step, before = value - before, value
            put(2 * step if step >= 0 else -2 * step - 1)
    groups += [0] * (-len(groups) % 8)
    words = [
        sum(group << (28 - 4 * i) for i, group in enumerate(groups[n : n + 8]))
        for n in range(0, len(groups), 8)
    ]
    return struct.pack(f'<II{len(words)}I', *pixels.shape[::-1], *words)


def zstd_image(pixels: NDArray[Any], encoding: str, *, as_gzip: bool = False) -> bytes:
    """Return the data of zstd_image_transport; up to Jazzy the plugin compresses with gzip."""
    raw = np.ascontiguousarray(pixels).tobytes()
    name = encoding.encode()
    head = struct.pack('<IIBII', *pixels.shape[:2], 0, len(raw) // pixels.shape[0], len(name))
    return head + name + (gzip.compress(raw, mtime=0) if as_gzip else zstd.compress(raw))


def quantized(depth_m: NDArray[Any], depth_max_m: float = 10.0) -> tuple[bytes, NDArray[Any]]:
    """Return the header and the uint16 inverse depth of compressedDepth for 32FC1."""
    quant_a = 100.0 * 101.0
    quant_b = 1.0 - quant_a / depth_max_m
    with np.errstate(divide='ignore'):
        inverse = np.where(depth_m > 0, np.rint(quant_a / depth_m + quant_b), 0)
    return struct.pack('<iff', 0, quant_a, quant_b), inverse.astype(np.uint16)
