"""A place index by locality-sensitive hashing of ORB descriptors.

Each hash table uses a fixed subset of the descriptor bits as its key, so that similar descriptors
often have the same key (Indyk and Motwani, STOC 1998; for ORB: Rublee et al., ICCV 2011). No
vocabulary is needed. Every vote is a descriptor match whose Hamming distance was checked, so that
the right place has several times as many votes as the others (docs/results/places_and_loops.md).
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
_HASH_SEED = 12345  # chosen: the bits of the keys are the same in all runs
# Not tuned: a segment is merged with the next larger one once its size exceeds this share of the
# size of that one. With a smaller share, adding takes longer; with a larger one, there are more
# segments, and queries take longer.
_MERGE_SHARE = 1 / 16
_ROW_BITS = np.uint64(32)
_ROW_MASK = np.uint64(0xFFFFFFFF)
_INITIAL_ROWS = 256  # chosen: rows of a new pool, which doubles when it is full

KeyArray = NDArray[np.uint64]

_NOTHING = np.empty(0, np.int64), np.empty(0, np.int64)


class HashIndex:
    """A place index that looks keyframes up by the hash keys of their descriptors.

    All descriptors are rows of one array, the pool. A segment holds, for each of T hash tables,
    the sorted numbers `key << 32 | pool row` of some descriptors. New descriptors become a new
    segment, which is merged with the one before it if that is not much larger.
    """

    def __init__(self, config: IndexConfig) -> None:
        self._config = config
        rng = np.random.default_rng(_HASH_SEED)
        orders = [rng.permutation(8 * DESCRIPTOR_BYTES) for _ in range(config.num_tables)]
        # (T, B) bits of the descriptor that are the key of each table
        self._bits = np.array([order[: config.key_bits] for order in orders], np.uint8)
        self._num_rows = 0  # number of rows of the pool that are in use
        self._pool: ByteArray = np.empty((_INITIAL_ROWS, DESCRIPTOR_BYTES), np.uint8)
        # uid of the keyframe of each row of the pool, or _REMOVED
        self._uid: IntArray = np.full(_INITIAL_ROWS, _REMOVED)
        self._rows: dict[int, slice] = {}  # rows of the pool, by the uid of their keyframe
        self._segments: list[KeyArray] = []  # from the largest to the smallest

    def update(self, atlas: Atlas) -> None:
        """Add the new keyframes of a map, and remove those that are no longer in it."""
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
        """Add keyframes that are not in the index, by uid, with their (N, 32) descriptors."""
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
        """Return the keyframes that match descriptors (N, 32), with most votes first."""
        descriptors = self._thinned(descriptors)
        keys = hash_keys(descriptors, self._bits)
        parts = [_NOTHING, *(self._collisions(segment, keys) for segment in self._segments)]
        query, row = (np.concatenate(column) for column in zip(*parts, strict=True))
        uid = self._uid[row]
        near = hamming(descriptors[query], self._pool[row]) <= self._config.max_hamming
        near &= uid != _REMOVED
        # A descriptor has one vote for a keyframe, even if it was found there several times.
        pairs = np.unique(uid[near] * len(descriptors) + query[near])
        uids, votes = np.unique(pairs // max(len(descriptors), 1), return_counts=True)
        order = np.argsort(-votes, kind='stable')
        return PlaceVotes(uids[order], votes[order])

    def _thinned(self, descriptors: ByteArray) -> ByteArray:
        count = min(len(descriptors), self._config.max_features)
        rows = np.linspace(0, len(descriptors) - 1, count).astype(np.int64)
        return descriptors[rows]

    def _collisions(self, segment: KeyArray, keys: KeyArray) -> tuple[IntArray, IntArray]:
        """Return the (C,) query and pool rows of descriptors with an equal key in one of T tables.

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
        if not is_kept.all():  # the rows of the tables are in different orders
            is_kept = self._uid[(both & _ROW_MASK).astype(np.int64)] != _REMOVED
            both = both[is_kept].reshape(len(both), -1)
        return np.sort(both, axis=1, kind='stable')  # fast, as it consists of two sorted parts
