"""What stands for several descriptors, against the plainest NumPy that says the same."""

import numpy as np
import pytest

from hoid_native import typical_descriptors


def test_it_has_the_least_median_distance_of_the_last_eight() -> None:
    rng = np.random.default_rng(0)
    sizes = rng.integers(1, 13, 300)
    starts = np.cumsum(sizes) - sizes
    descriptors = rng.integers(0, 4, (sizes.sum(), 32)).astype(np.uint8)
    expected = []
    for start, size in zip(starts, sizes, strict=True):
        rows = np.arange(start, start + size)[-8:]
        apart = np.bitwise_count(descriptors[rows, None] ^ descriptors[rows]).sum(-1)
        typical = np.median(apart, axis=1).argmin()
        expected.append(rows[typical] if size > 2 else rows[-1])
    assert typical_descriptors(descriptors, starts).tolist() == expected


def test_no_groups_have_no_rows() -> None:
    assert len(typical_descriptors(np.zeros((0, 32), np.uint8), np.zeros(0, np.int64))) == 0


def test_groups_that_hold_nothing_are_refused() -> None:
    descriptors = np.zeros((4, 32), np.uint8)
    with pytest.raises(ValueError, match='starts: 0 to 4 is not within 0 to 3'):
        typical_descriptors(descriptors, np.array([0, 4]))
    for starts in ([0, 2, 2], [0, 3, 1]):
        with pytest.raises(ValueError, match='starts: must ascend'):
            typical_descriptors(descriptors, np.array(starts))
