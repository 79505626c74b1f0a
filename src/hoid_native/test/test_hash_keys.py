"""Hash keys of descriptors, against NumPy."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_native import hash_keys


def given(
    count: int, key_bits: int, tables: int = 3
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    rng = np.random.default_rng(count)
    bits = np.array([rng.permutation(256)[:key_bits] for _ in range(tables)], np.uint8)
    return rng.integers(0, 256, (count, 32)).astype(np.uint8), bits


@pytest.mark.parametrize('key_bits', [1, 8, 20, 30, 32])
def test_a_key_has_the_chosen_bits_of_the_descriptor(key_bits: int) -> None:
    descriptors, bits = given(200, key_bits)
    chosen = np.unpackbits(descriptors, axis=1)[:, bits]  # (N, T, B)
    weights = np.uint64(1) << np.arange(key_bits, dtype=np.uint64)
    expected = (chosen * weights).sum(axis=2, dtype=np.uint64).T << np.uint64(32)
    np.testing.assert_array_equal(hash_keys(descriptors, bits), expected)


def test_a_key_of_more_than_32_bits_is_refused() -> None:
    descriptors, _ = given(4, 20)
    with pytest.raises(ValueError, match='bits: a key has at most 32 bits'):
        hash_keys(descriptors, np.zeros((1, 33), np.uint8))
