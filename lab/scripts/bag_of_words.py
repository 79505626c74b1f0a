"""A binary bag of words for place recognition, for comparison with the hashing index.

Galvez-Lopez and Tardos, T-RO 2012: a tree of binary centers by k-majority, tf-idf weights, and
the L1 score with an inverted file.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import ByteArray, Float32Array, IntArray


class Vocabulary:
    """A tree of words; the centers of each level are (nodes, branching, 32) bytes."""

    def __init__(self, training: ByteArray, branching: int, depth: int, seed: int = 0) -> None:
        self.branching = branching
        rng = np.random.default_rng(seed)
        bits = np.unpackbits(training, axis=1).astype(np.float32) * 2 - 1
        node = np.zeros(len(training), np.int64)
        self.levels: list[NDArray[np.uint64]] = []
        for level in range(depth):
            count = branching**level
            centers = np.zeros((count, branching, 32), np.uint8)
            below = node * branching
            for n in np.unique(node).tolist():
                rows = np.flatnonzero(node == n)
                center, chosen = _k_majority(bits[rows], branching, rng)
                centers[n] = np.packbits(center > 0, axis=1)
                below[rows] += chosen
            node = below
            self.levels.append(centers.view(np.uint64))

    @property
    def num_words(self) -> int:
        """Return the number of leaves of the tree."""
        return int(self.branching ** len(self.levels))

    def words(self, descriptors: ByteArray) -> IntArray:
        """Return the words (N,) of descriptors (N, 32)."""
        query = np.ascontiguousarray(descriptors).view(np.uint64)
        node = np.zeros(len(query), np.int64)
        for centers in self.levels:
            apart = np.bitwise_count(centers[node] ^ query[:, None]).sum(2, dtype=np.uint16)
            node = node * self.branching + np.argmin(apart, axis=1)
        return node


def _k_majority(
    bits: Float32Array, count: int, rng: np.random.Generator, iterations: int = 5
) -> tuple[Float32Array, IntArray]:
    """Return centers (count, 256) of +-1, and the index (N,) of the nearest to each row."""
    center = bits[rng.choice(len(bits), count, replace=len(bits) < count)]
    for _ in range(iterations):
        member = np.eye(count, dtype=np.float32)[np.argmax(bits @ center.T, axis=1)]
        votes = member.T @ bits
        center = np.where(member.sum(0)[:, None] > 0, np.where(votes >= 0, 1, -1), center)
        center = center.astype(np.float32)
    return center, np.argmax(bits @ center.T, axis=1)


class BagIndex:
    """Inverted file with the tf-idf vectors of images, built once."""

    def __init__(self, vocabulary: Vocabulary, images: list[ByteArray]) -> None:
        self._vocabulary = vocabulary
        self._num_images = len(images)
        words = [vocabulary.words(descriptors) for descriptors in images]
        image = np.repeat(np.arange(len(images)), [len(w) for w in words])
        pairs, count = np.unique(np.concatenate(words) * len(images) + image, return_counts=True)
        word, self._image = pairs // len(images), pairs % len(images)
        frequency = np.bincount(word, minlength=vocabulary.num_words)
        self._idf = np.log(len(images) / np.maximum(frequency, 1))
        weight = count * self._idf[word]
        self._weight = weight / np.bincount(self._image, weight, len(images))[self._image]
        self._start = np.searchsorted(word, np.arange(vocabulary.num_words + 1))

    def scores(self, descriptors: ByteArray) -> NDArray[np.float64]:
        """Return the similarities (images,) to all images, in [0, 1]."""
        word, count = np.unique(self._vocabulary.words(descriptors), return_counts=True)
        weight = count * self._idf[word]
        weight = weight / max(weight.sum(), 1e-12)
        size = self._start[word + 1] - self._start[word]
        offset = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
        rows = np.repeat(self._start[word], size) + offset
        shared = np.minimum(np.repeat(weight, size), self._weight[rows])
        return np.asarray(np.bincount(self._image[rows], shared, self._num_images), np.float64)
