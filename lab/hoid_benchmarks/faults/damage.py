"""Random damage to bytes, repeatable by seed."""

from __future__ import annotations

import numpy as np

Rng = np.random.Generator


def damaged(data: bytes, rng: Rng) -> bytes:
    """Return bytes with one kind of damage at a random place; empty bytes stay empty."""
    if not data:
        return data
    at = int(rng.integers(len(data)))
    end = min(len(data), at + int(rng.geometric(0.02)))
    kinds = (
        _flipped(data, rng),
        data[:at],  # cut off
        data[:at] + data[end:],
        data[:at] + bytes(end - at) + data[end:],
        data[:at] + rng.bytes(end - at) + data[end:],
        data[:end] + data[at:],  # a repeated part
    )
    return kinds[int(rng.integers(len(kinds)))]


def _flipped(data: bytes, rng: Rng) -> bytes:
    out = bytearray(data)
    for place in rng.integers(len(data), size=int(rng.integers(1, 9))):
        out[place] ^= 1 << int(rng.integers(8))
    return bytes(out)
