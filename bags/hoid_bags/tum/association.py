"""Pairing of color and depth images by their stamps."""

from __future__ import annotations

import logging

import numpy as np

from hoid_common.errors import InputError
from hoid_common.sync import constant_offset_text, offset_text
from hoid_common.values import NS_PER_S, IntArray

_LOG = logging.getLogger(__name__)
MAX_PAIR_GAP_NS = 20_000_000
"""Limit for the difference of the stamps of a pair: the default of the TUM benchmark's tool
`associate.py`. Images of one stream are 33 ms apart.
"""
# Stamps are refused if an image could be paired with more images of the other stream than this, on
# average. Chosen: a 60 Hz camera has two or three.
_MAX_CANDIDATES = 20
_USUAL_SHARE = 0.9  # chosen: a warning is logged if a smaller ratio of the color images has depth


def associate(
    first_ns: IntArray,
    second_ns: IntArray,
    max_gap_ns: int = MAX_PAIR_GAP_NS,
    *,
    source: object = 'images',
) -> IntArray:
    """Return the pairs (N, 2) of indices whose stamps lie less than `max_gap_ns` apart.

    As in the TUM benchmark's tool, the closest pairs are chosen first, and no image is used twice.
    Pairs are ordered by the first index. Stamps (A,) and (B,) are in order of time; InputError,
    which begins with `source`, if they are much closer than those of any camera.
    """
    low = np.searchsorted(second_ns, first_ns - max_gap_ns, side='right')
    high = np.searchsorted(second_ns, first_ns + max_gap_ns, side='left')
    counts = high - low
    if counts.sum() > _MAX_CANDIDATES * len(first_ns):
        raise InputError(f'{source}: stamps lie too close to each other; are they in seconds?')
    i = np.repeat(np.arange(len(first_ns)), counts)
    j = np.arange(len(i)) - np.repeat(np.cumsum(counts) - counts, counts) + np.repeat(low, counts)
    order = np.lexsort((j, i, np.abs(first_ns[i] - second_ns[j])))
    partner = np.full(len(first_ns), -1, np.int64)
    taken = np.zeros(len(second_ns), bool)
    for candidate in order:
        a, b = i[candidate], j[candidate]
        if partner[a] < 0 and not taken[b]:
            partner[a], taken[b] = b, True
    paired = np.flatnonzero(partner >= 0)
    return np.column_stack([paired, partner[paired]])


def pair_images(
    color_ns: IntArray, depth_ns: IntArray, limit_ns: int, offset_ns: int, source: object
) -> IntArray:
    """Return the pairs (N, 2) of indices of color (A,) and depth (B,), as `associate` does.

    `offset_ns`, by which the stamps of depth are too late, is subtracted first. A constant offset
    that probably pairs the wrong images is logged as a warning, and so are color images without
    depth if they are more than a tenth. InputError: there is no pair, or all stamps of a stream
    are zero.
    """
    for kind, stamps_ns in (('color', color_ns), ('depth', depth_ns)):
        if len(stamps_ns) > 1 and not stamps_ns.any():
            raise InputError(
                f'{source}: the {kind} images have no stamps (zeros); set the stamp in the driver'
            )
    shifted_ns = depth_ns - offset_ns
    pairs = associate(color_ns, shifted_ns, limit_ns, source=source)
    if not len(pairs):
        raise InputError(f'{source}: {_gap_text(color_ns, shifted_ns, limit_ns)}')
    if text := constant_offset_text(color_ns, shifted_ns):
        _LOG.warning('%s: %s', source, text)
    if len(pairs) < _USUAL_SHARE * len(color_ns):
        _LOG.warning(
            '%s: %d of %d color images, at %.1f Hz, have no depth image within %.0f ms and are '
            'left out; depth comes at %.1f Hz',
            source, len(color_ns) - len(pairs), len(color_ns), _rate_hz(color_ns),
            1e3 * limit_ns / NS_PER_S, _rate_hz(depth_ns),
        )  # fmt: skip
    return pairs


def _rate_hz(stamps_ns: IntArray) -> float:
    periods_ns = np.diff(stamps_ns)
    return float(NS_PER_S / np.median(periods_ns)) if len(periods_ns) else 0.0


def _gap_text(first_ns: IntArray, second_ns: IntArray, limit_ns: int) -> str:
    """Return one line with the median gap of the streams, which explains why there is no pair."""
    after = np.clip(np.searchsorted(second_ns, first_ns), 1, max(len(second_ns) - 1, 1))
    near = np.stack([second_ns[after - 1], second_ns[np.minimum(after, len(second_ns) - 1)]])
    gaps_ns = (near - first_ns)[np.abs(near - first_ns).argmin(axis=0), np.arange(len(first_ns))]
    return f'no image pairs: {offset_text(float(np.median(gaps_ns)), limit_ns)}'
