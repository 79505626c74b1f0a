"""Compares keyframe indices: recall, margin and time with thousands of keyframes.

    python lab/scripts/place_recognition.py SEQUENCE [SEQUENCE ...] [--keyframes 2000]

A SEQUENCE is a TUM folder or a bag with ground truth. Every tenth frame is a keyframe and a query.
Distractors fill the index: sets of real descriptors with some changed bits. Correct results are
keyframes of the same recording with nearly the same view, more than five seconds away. Keyframes
with a partly overlapping view count neither as correct nor as wrong.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from bag_of_words import BagIndex, Vocabulary
from hoid_bags.sequence import open_sequence
from hoid_common.values import S_PER_NS, BoolArray, ByteArray, FloatArray
from hoid_filter.config import ExtractionConfig
from hoid_filter.extraction.extractor import OrbExtractor
from rgbd_slam.config.place_config import IndexConfig
from rgbd_slam.places.hash_index import HashIndex

_EVERY = 10
_APART_S = 5.0
_SAME_M, _SAME_DEG = 0.5, 20.0
_OTHER_M, _OTHER_DEG = 1.5, 60.0
_DISTRACTOR_FLIP = 0.08
_MS = 1e3

Scores = Callable[[ByteArray], NDArray[np.float64]]


class Keyframes(NamedTuple):
    """The keyframes of one recording."""

    descriptors: list[ByteArray]
    stamp_s: FloatArray  # (N,)
    T_world_camera: FloatArray  # (N, 4, 4)


class Truth(NamedTuple):
    """Which keyframes (columns) show the same place as a query (row), and which another one."""

    same: BoolArray  # (Q, N)
    other: BoolArray  # (Q, N)


class Measured(NamedTuple):
    """Recall and times of an index."""

    recall_1: float
    recall_5: float
    margin: float  # median ratio of the best correct to the best wrong score
    query_ms: float
    worst_ms: float


def keyframes_of(path: Path) -> Keyframes:
    """Return the descriptors and true poses of every tenth frame of a recording."""
    sequence = open_sequence(path)
    extractor = OrbExtractor(ExtractionConfig())
    truth = sequence.ground_truth
    if truth is None:
        raise SystemExit(f'{path} has no ground truth')
    descriptors, stamp_s, poses = [], [], []
    for n, frame in enumerate(sequence):
        if n % _EVERY:
            continue
        gray = np.asarray(cv2.cvtColor(frame.image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)
        corners = extractor.detect(gray)
        chosen = extractor.choose(corners, None, gray.size)
        features = extractor.describe(corners, chosen, frame.depth_m, frame.stamp_ns)
        descriptors.append(features.descriptors[features.depth_m > 0])
        stamp_s.append(S_PER_NS * frame.stamp_ns)
        nearest = np.argmin(np.abs(truth.stamps_ns - frame.stamp_ns))
        poses.append(truth.T_world_camera[nearest])
    return Keyframes(descriptors, np.array(stamp_s), np.array(poses))


def truth_of(recordings: list[Keyframes], num_images: int) -> Truth:
    """Return which pairs of keyframes show the same place; distractors never do."""
    total = sum(len(r.descriptors) for r in recordings)
    same = np.zeros((total, num_images), np.bool_)
    other = np.ones((total, num_images), np.bool_)
    start = 0
    for r in recordings:
        part = slice(start, start + len(r.descriptors))
        start = part.stop
        position, axis = r.T_world_camera[:, :3, 3], r.T_world_camera[:, :3, 2]
        apart_m = np.linalg.norm(position[:, None] - position, axis=2)
        angle_deg = np.rad2deg(np.arccos(np.clip(axis @ axis.T, -1, 1)))
        long_ago = np.abs(r.stamp_s[:, None] - r.stamp_s) > _APART_S
        same[part, part] = (apart_m < _SAME_M) & (angle_deg < _SAME_DEG) & long_ago
        other[part, part] = (apart_m > _OTHER_M) | (angle_deg > _OTHER_DEG)
    return Truth(same, other)


def distractors(pool: ByteArray, count: int, size: int) -> list[ByteArray]:
    """Return sets of descriptors, chosen at random from the pool, with some changed bits."""
    rng = np.random.default_rng(0)
    out = []
    for _ in range(count):
        flips = rng.random((size, 256)) < _DISTRACTOR_FLIP
        out.append(pool[rng.integers(0, len(pool), size)] ^ np.packbits(flips, axis=1))
    return out


def measure(scores: Scores, queries: list[ByteArray], truth: Truth) -> Measured:
    """Return the recall and times over all queries that have a correct result."""
    asked = np.flatnonzero(truth.same.any(axis=1))
    ranks, margins, spent_s = [], [], []
    for n in asked.tolist():
        start_s = time.thread_time()
        score = scores(queries[n])
        spent_s.append(time.thread_time() - start_s)
        right, wrong = score[truth.same[n]].max(), score[truth.other[n]]
        ranks.append(int((wrong >= right).sum()) if right > 0 else len(wrong))
        margins.append(right / max(wrong.max(), 1e-12))
    rank = np.array(ranks)
    return Measured(
        float(np.mean(rank < 1)),
        float(np.mean(rank < 5)),
        float(np.median(margins)),
        _MS * float(np.median(spent_s)),
        _MS * float(np.max(spent_s)),
    )


def hashing(images: list[ByteArray], config: IndexConfig) -> Scores:
    """Return the scoring function of the hashing index."""
    index = HashIndex(config)
    for uid, descriptors in enumerate(images):
        index.insert({uid: descriptors})

    def scores(descriptors: ByteArray) -> NDArray[np.float64]:
        votes = index.query(descriptors)
        out = np.zeros(len(images))
        out[votes.uids] = votes.votes
        return out

    scores(images[0])  # the first query sorts the added entries
    return scores


def words(images: list[ByteArray], training: ByteArray, branching: int, depth: int) -> Scores:
    """Return the scoring function of a bag of words."""
    return BagIndex(Vocabulary(training, branching, depth), images).scores


def main() -> None:
    """Print a table with a row for each index."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('sequence', nargs='+', type=Path)
    parser.add_argument('--keyframes', type=int, default=2000)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    recordings = [keyframes_of(path) for path in args.sequence]
    queries = [d for r in recordings for d in r.descriptors]
    pool = np.concatenate(queries)
    size = int(np.median([len(d) for d in queries]))
    images = queries + distractors(pool, args.keyframes - len(queries), size)
    truth = truth_of(recordings, len(images))
    early = np.concatenate(queries[:20])
    methods: dict[str, Callable[[], Scores]] = {}
    for tables, bits in ((2, 16), (4, 16), (4, 18), (4, 20), (8, 20)):
        config = IndexConfig(num_tables=tables, key_bits=bits)
        methods[f'hashing, {tables} tables of {bits} bits'] = partial(hashing, images, config)
    for branching, depth in ((16, 3), (10, 4)):
        for name, training in (('its first 20 keyframes', early), ('all of them', pool[::5])):
            methods[f'words, {branching}^{depth}, trained on {name}'] = partial(
                words, images, training, branching, depth
            )
    asked = int(truth.same.any(axis=1).sum())
    sys.stdout.write(f'{len(images)} keyframes, {asked} queries with a right answer\n')
    sys.stdout.write('| index | recall at 1 | at 5 | margin | query ms, median | worst |\n')
    sys.stdout.write('|---|---|---|---|---|---|\n')
    for name, make in methods.items():
        m = measure(make(), queries, truth)
        sys.stdout.write(
            f'| {name} | {m.recall_1:.3f} | {m.recall_5:.3f} | {m.margin:.2f} '
            f'| {m.query_ms:.1f} | {m.worst_ms:.1f} |\n'
        )


if __name__ == '__main__':
    main()
