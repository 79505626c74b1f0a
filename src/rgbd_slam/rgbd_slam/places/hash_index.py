"""A place index by locality-sensitive hashing of ORB descriptors.

Each hash table uses a fixed subset of the descriptor bits as its key, so that similar descriptors
often have the same key (Indyk and Motwani, STOC 1998; for ORB: Rublee et al., ICCV 2011). No
vocabulary is needed. Every vote is a descriptor match checked by its distance: the right place has
several times as many votes as the others, where scores of bags of words differ by a few percent
(docs/results/places_and_loops.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import DESCRIPTOR_BYTES, ByteArray, IntArray
from rgbd_slam.config.place_config import IndexConfig
from rgbd_slam.matching.matching import hamming
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.places.place_index import PlaceVotes

_REMOVED = -1
_HASH_SEED = 12345  # chosen: the bits of the keys are the same in all runs
_MERGE_SHARE = 0.25  # not tuned: largest size of the small segment, relative to the large one
_ROW_BITS = np.uint64(32)
_BLOCK = 256  # chosen: descriptors whose unpacked bits fit into the cache

KeyArray = NDArray[np.uint64]


class HashIndex:
    """Keyframes by the hash keys of their descriptors.

    A segment holds, for each of T tables, sorted numbers `key << 32 | pool row`. New descriptors
    are added to a small segment, which is merged with the large one when it has reached a share of
    its size. Therefore adding is cheap on average, and a query searches two sorted arrays in each
    table.
    """

    def __init__(self, config: IndexConfig) -> None:
        self._config = config
        rng = np.random.default_rng(_HASH_SEED)
        orders = [rng.permutation(8 * DESCRIPTOR_BYTES) for _ in range(config.num_tables)]
        # (256, T) value of each descriptor bit in the key of each table
        self._weights = np.zeros((8 * DESCRIPTOR_BYTES, config.num_tables))
        for t, order in enumerate(orders):
            self._weights[order[: config.key_bits], t] = 2.0 ** np.arange(config.key_bits)
        self._members: IntArray = np.empty(0, np.int64)  # (K,) uids, ascending
        self._pending: list[tuple[int, ByteArray]] = []
        self._pool: ByteArray = np.empty((0, DESCRIPTOR_BYTES), np.uint8)  # (M, 32)
        self._uid: IntArray = np.empty(0, np.int64)  # (M,) uid of the keyframe, or _REMOVED
        self._large: KeyArray = np.empty((self._config.num_tables, 0), np.uint64)
        self._small = self._large

    def update(self, atlas: Atlas) -> None:
        """Add the new keyframes of a map, by features that observe points; remove the gone."""
        keyframes = atlas.keyframes
        rows = keyframes.indices()
        rows = rows[np.argsort(keyframes.uid[rows])]
        uids = keyframes.uid[rows]
        for uid in np.setdiff1d(self._members, uids, assume_unique=True).tolist():
            self.remove(uid)
        for i in rows[~np.isin(uids, self._members, assume_unique=True)].tolist():
            seen = keyframes.point_of_feature[i] != NO_POINT
            self._append(int(keyframes.uid[i]), keyframes.descriptors[i, seen])
        self._members = uids

    def add(self, uid: int, descriptors: ByteArray) -> None:
        """Add a keyframe with its (N, 32) descriptors, thinned evenly to `max_features`."""
        self._members = np.union1d(self._members, [uid])
        self._append(uid, descriptors)

    def remove(self, uid: int) -> None:
        """Remove a keyframe, if it is in the index."""
        if uid in self._members:
            self._members = self._members[self._members != uid]
            self._pending = [entry for entry in self._pending if entry[0] != uid]
            self._uid[self._uid == uid] = _REMOVED

    def query(self, descriptors: ByteArray) -> PlaceVotes:
        """Return keyframes that match descriptors (N, 32), most votes first, then by uid."""
        self._insert_pending()
        descriptors = self._thinned(descriptors)
        keys = self._keys(descriptors)
        parts = [self._collisions(segment, keys) for segment in (self._large, self._small)]
        query, row = (np.concatenate(column) for column in zip(*parts, strict=True))
        uid = self._uid[row]
        near = hamming(descriptors[query], self._pool[row]) <= self._config.max_hamming
        near &= uid != _REMOVED
        # A pair found in two tables counts once.
        pairs = np.unique(uid[near] * len(descriptors) + query[near])
        uids, votes = np.unique(pairs // max(len(descriptors), 1), return_counts=True)
        order = np.argsort(-votes, kind='stable')
        return PlaceVotes(uids[order], votes[order])

    def _append(self, uid: int, descriptors: ByteArray) -> None:
        self._pending.append((uid, self._thinned(descriptors)))

    def _thinned(self, descriptors: ByteArray) -> ByteArray:
        count = min(len(descriptors), self._config.max_features)
        rows = np.linspace(0, len(descriptors) - 1, count).astype(np.int64)
        return descriptors[rows]

    def _keys(self, descriptors: ByteArray) -> KeyArray:
        """Return the (T, N) keys, shifted to leave space for the pool row."""
        keys = np.empty((self._config.num_tables, len(descriptors)), np.uint64)
        for start in range(0, len(descriptors), _BLOCK):
            part = slice(start, start + _BLOCK)
            bits = np.unpackbits(descriptors[part], axis=1).astype(np.float64)
            keys[:, part] = (bits @ self._weights).T
        return keys << _ROW_BITS

    def _collisions(self, segment: KeyArray, keys: KeyArray) -> tuple[IntArray, IntArray]:
        """Return (C,) queries and (C,) pool rows with equal keys, except for too common keys."""
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
        return query, (found & np.uint64(0xFFFFFFFF)).astype(np.int64)

    def _insert_pending(self) -> None:
        """Insert the pending descriptors into the small segment, or merge the segments."""
        if not self._pending:
            return
        sizes = [len(descriptors) for _, descriptors in self._pending]
        new = np.concatenate([descriptors for _, descriptors in self._pending])
        first = len(self._uid)
        self._uid = np.concatenate([self._uid, np.repeat([u for u, _ in self._pending], sizes)])
        self._pool = np.concatenate([self._pool, new])
        self._pending = []
        if self._small.shape[1] + len(new) > _MERGE_SHARE * self._large.shape[1]:
            self._merge()
        else:
            fresh = self._sorted_segment(new, first)
            self._small = np.sort(np.concatenate([self._small, fresh], axis=1), kind='stable')

    def _merge(self) -> None:
        """Merge the segments and delete the descriptors of removed keyframes."""
        kept = np.flatnonzero(self._uid != _REMOVED)
        self._pool, self._uid = self._pool[kept], self._uid[kept]
        self._large = self._sorted_segment(self._pool, 0)
        self._small = self._large[:, :0]

    def _sorted_segment(self, descriptors: ByteArray, first: int) -> KeyArray:
        """Return the (T, N) segment of descriptors whose pool rows start at `first`."""
        rows = np.arange(first, first + len(descriptors), dtype=np.uint64)
        return np.sort(self._keys(descriptors) | rows, axis=1)
