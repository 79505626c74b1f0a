"""The most distinctive descriptor of each group, against NumPy."""

import numpy as np
import pytest

from hoid_native import distinctive_descriptors


def test_the_median_distance_to_the_last_eight_is_smallest() -> None:
    rng = np.random.default_rng(0)
    sizes = rng.integers(1, 13, 300)
    starts = np.cumsum(sizes) - sizes
    descriptors = rng.integers(0, 4, (sizes.sum(), 32)).astype(np.uint8)
    expected = []
    for start, size in zip(starts, sizes, strict=True):
        rows = np.arange(start, start + size)[-8:]
        apart = np.bitwise_count(descriptors[rows, None] ^ descriptors[rows]).sum(-1)
        best = np.median(apart, axis=1).argmin()
        expected.append(rows[best] if size > 2 else rows[-1])
    assert distinctive_descriptors(descriptors, starts).tolist() == expected


def test_no_groups_have_no_rows() -> None:
    assert len(distinctive_descriptors(np.zeros((0, 32), np.uint8), np.zeros(0, np.int64))) == 0


def test_empty_groups_are_refused() -> None:
    descriptors = np.zeros((4, 32), np.uint8)
    with pytest.raises(ValueError, match='starts: 0 to 4 is not within 0 to 3'):
        distinctive_descriptors(descriptors, np.array([0, 4]))
    for starts in ([0, 2, 2], [0, 3, 1]):
        with pytest.raises(ValueError, match='starts: must ascend'):
            distinctive_descriptors(descriptors, np.array(starts))
