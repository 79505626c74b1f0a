"""A place index by locality-sensitive hashing of ORB descriptors.

Each hash table uses a fixed subset of the descriptor bits as its key, so that similar descriptors
often have the same key (Indyk and Motwani, STOC 1998; for ORB: Rublee et al., ICCV 2011). No
vocabulary is needed. Each vote is a descriptor match with a checked Hamming distance, so that the
right place gets several times as many votes as others (docs/results/places_and_loops.md).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import DESCRIPTOR_BYTES, ByteArray, IntArray
from hoid_native import hash_keys
from rgbd_slam.config.place_config import IndexConfig
from rgbd_slam.matching.matching import hamming
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.places.place_index import PlaceVotes

_REMOVED = -1
_HASH_SEED = 12345  # chosen: seed of the choice of key bits, which is the same in all runs
# Not tuned: a segment is merged with the next larger one if its size exceeds this ratio of that
# size. With a smaller ratio, adding takes longer; with a larger one, there are more segments, and
# queries take longer.
_MERGE_SHARE = 1 / 16
_ROW_BITS = np.uint64(32)
_ROW_MASK = np.uint64(0xFFFFFFFF)
_INITIAL_ROWS = 256  # chosen: number of rows of a new pool, which doubles when it is full

KeyArray = NDArray[np.uint64]

_NOTHING = np.empty(0, np.int64), np.empty(0, np.int64)


class HashIndex:
    """A place index that looks keyframes up by the hash keys of their descriptors.

    All descriptors are rows of one array, the pool. A segment has, for each of T hash tables, the
    sorted numbers `key << 32 | pool row` of a part of the descriptors. New descriptors form a new
    segment, which is merged with the previous one unless that is much larger.
    """

    def __init__(self, config: IndexConfig) -> None:
        self._config = config
        rng = np.random.default_rng(_HASH_SEED)
        orders = [rng.permutation(8 * DESCRIPTOR_BYTES) for _ in range(config.num_tables)]
        # (T, B) indices of the descriptor bits that form the key of each table
        self._bits = np.array([order[: config.key_bits] for order in orders], np.uint8)
        self._num_rows = 0  # number of used rows of the pool
        self._pool: ByteArray = np.empty((_INITIAL_ROWS, DESCRIPTOR_BYTES), np.uint8)
        # uid of the keyframe to which each row of the pool belongs, or _REMOVED
        self._uid: IntArray = np.full(_INITIAL_ROWS, _REMOVED)
        self._rows: dict[int, slice] = {}  # by uid of a keyframe: its rows of the pool
        self._segments: list[KeyArray] = []  # from the largest to the smallest

    def update(self, atlas: Atlas) -> None:
        """Add new keyframes of a map, and remove those that are not in the map any more."""
        keyframes = atlas.keyframes
        rows = keyframes.indices_by_uid()
        uids, indexed = keyframes.uid[rows], np.array(list(self._rows), np.int64)
        for uid in np.setdiff1d(indexed, uids, assume_unique=True).tolist():
            self.remove(uid)
        new = rows[~np.isin(uids, indexed, assume_unique=True)]
        has_point = keyframes.point_of_feature[new] != NO_POINT
        self.insert(
            {
                int(keyframes.uid[i]): keyframes.descriptors[i, seen]
                for i, seen in zip(new.tolist(), has_point, strict=True)
            }
        )

    def insert(self, keyframes: Mapping[int, ByteArray]) -> None:
        """Add keyframes that are not in the index yet, by uid, with descriptors (N, 32)."""
        if not keyframes:
            return
        new = [self._thinned(descriptors) for descriptors in keyframes.values()]
        first, end = self._num_rows, self._num_rows + sum(map(len, new))
        if end > len(self._pool):
            more = max(end, 2 * len(self._pool)) - first
            unused = np.empty((more, DESCRIPTOR_BYTES), np.uint8)
            self._pool = np.concatenate([self._pool[:first], unused])
            self._uid = np.concatenate([self._uid[:first], np.full(more, _REMOVED)])
        for uid, descriptors in zip(keyframes, new, strict=True):
            rows = slice(self._num_rows, self._num_rows + len(descriptors))
            self._rows[uid], self._uid[rows], self._pool[rows] = rows, uid, descriptors
            self._num_rows = rows.stop
        keys = hash_keys(self._pool[first:end], self._bits)
        keys |= np.arange(first, end, dtype=np.uint64)
        keys.sort(axis=1)
        self._segments.append(keys)
        while len(self._segments) > 1:
            large, small = self._segments[-2:]
            if small.shape[1] <= _MERGE_SHARE * large.shape[1]:
                break
            self._segments[-2:] = [self._merged(large, small)]

    def remove(self, uid: int) -> None:
        """Remove a keyframe, if it is in the index."""
        self._uid[self._rows.pop(uid, slice(0))] = _REMOVED

    def query(self, descriptors: ByteArray) -> PlaceVotes:
        """Return the keyframes that match descriptors (N, 32), those with most votes first."""
        descriptors = self._thinned(descriptors)
        keys = hash_keys(descriptors, self._bits)
        parts = [_NOTHING, *(self._collisions(segment, keys) for segment in self._segments)]
        query, row = (np.concatenate(column) for column in zip(*parts, strict=True))
        uid = self._uid[row]
        near = hamming(descriptors[query], self._pool[row]) <= self._config.max_hamming
        near &= uid != _REMOVED
        # A descriptor has only one vote for a keyframe, even if it matches there several times.
        pairs = np.unique(uid[near] * len(descriptors) + query[near])
        uids, votes = np.unique(pairs // max(len(descriptors), 1), return_counts=True)
        order = np.argsort(-votes, kind='stable')
        return PlaceVotes(uids[order], votes[order])

    def _thinned(self, descriptors: ByteArray) -> ByteArray:
        count = min(len(descriptors), self._config.max_features)
        rows = np.linspace(0, len(descriptors) - 1, count).astype(np.int64)
        return descriptors[rows]

    def _collisions(self, segment: KeyArray, keys: KeyArray) -> tuple[IntArray, IntArray]:
        """Return query rows (C,) and pool rows (C,) of descriptors with equal keys in a table.

        Keys that are too common (`max_bucket`) are left out.
        """
        ends = keys + (np.uint64(1) << _ROW_BITS)
        tables = range(len(keys))
        low = np.stack([np.searchsorted(segment[t], keys[t]) for t in tables])
        count = np.stack([np.searchsorted(segment[t], ends[t]) for t in tables]) - low
        count[count > self._config.max_bucket] = 0
        start = (low + segment.shape[1] * np.arange(len(keys))[:, None]).ravel()
        flat = count.ravel()
        offset = np.arange(flat.sum()) - np.repeat(np.cumsum(flat) - flat, flat)
        found = segment.ravel()[np.repeat(start, flat) + offset]
        query = np.repeat(np.tile(np.arange(keys.shape[1]), len(keys)), flat)
        return query, (found & _ROW_MASK).astype(np.int64)

    def _merged(self, large: KeyArray, small: KeyArray) -> KeyArray:
        both = np.concatenate([large, small], axis=1)
        is_kept = self._uid[(both[0] & _ROW_MASK).astype(np.int64)] != _REMOVED
        if not is_kept.all():  # each table has the rows in another order
            is_kept = self._uid[(both & _ROW_MASK).astype(np.int64)] != _REMOVED
            both = both[is_kept].reshape(len(both), -1)
        # Fast, because it consists of two sorted parts.
        return np.sort(both, axis=1, kind='stable')
