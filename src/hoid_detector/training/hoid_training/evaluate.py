"""Measures a detector on rendered scenes of seeds that training never uses.

Usage: python -m hoid_training.evaluate MODEL.onnx [--seeds N] [--frames N] [--score S]
It needs the suite's own environment only.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from hoid_bags.synth.config import SceneConfig
from hoid_bags.synth.scene import SceneRenderer, SynthFrame
from hoid_common.values import PERSON, BoolArray, Detections, Float32Array
from hoid_detector.config import DetectorConfig
from hoid_detector.onnx_detector import OnnxDetector

MIN_VISIBLE_PX = 400  # at VGA: an object of which less shows need not be found
_IOU = 0.5
_FIRST_SEED = 500
_PATHS = ('room', 'room', 'loop')


@dataclass
class Count:
    """Hits and misses of one class."""

    asked: int = 0  # objects that should be found
    found: int = 0
    reported: int = 0
    right: int = 0  # reports that fit an object, however little of it shows


@dataclass
class Tally:
    """Counts by class."""

    counts: dict[str, Count] = field(default_factory=dict)

    def of(self, name: str) -> Count:
        """Return the count of a class."""
        return self.counts.setdefault(name, Count())

    def total(self, names: set[str]) -> Count:
        """Return the sum over classes."""
        total = Count()
        for name in names & self.counts.keys():
            c = self.counts[name]
            total.asked += c.asked
            total.found += c.found
            total.reported += c.reported
            total.right += c.right
        return total


class Truth(NamedTuple):
    """The objects of one frame."""

    names: tuple[str, ...]
    boxes: Float32Array  # (N, 4)
    asked: BoolArray  # (N,)


def overlaps(a: Float32Array, b: Float32Array) -> Float32Array:
    """Return (N, M) intersection over union."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    shared = np.maximum(high - low, 0).prod(-1)
    areas = [(x[:, 2:] - x[:, :2]).prod(-1) for x in (a, b)]
    return np.asarray(shared / np.maximum(areas[0][:, None] + areas[1][None] - shared, 1e-9))


def count(tally: Tally, truth: Truth, found: Detections) -> None:
    """Match the detections of one frame to its objects, the strongest first."""
    overlap = overlaps(found.boxes_xyxy_px, truth.boxes)
    same = np.array([[a == b for b in truth.names] for a in found.class_names], bool)
    overlap = np.where(same.reshape(overlap.shape), overlap, 0)
    free = np.ones(len(truth.names), bool)
    for k in np.argsort(-found.scores, kind='stable'):
        c = tally.of(found.class_names[k])
        c.reported += 1
        row = overlap[k] * free
        if len(row) and row.max() >= _IOU:
            c.right += 1
            free[row.argmax()] = False
    for name, asked, missed in zip(truth.names, truth.asked, free, strict=True):
        tally.of(name).asked += int(asked)
        tally.of(name).found += int(asked and not missed)


def truth_of(synth: SynthFrame, scale: float) -> Truth:
    """Return a frame's objects."""
    visible = np.bincount(synth.instance_image.ravel(), minlength=256)
    asked = visible[list(synth.instances)] >= MIN_VISIBLE_PX * scale**2
    return Truth(synth.detections.class_names, synth.detections.boxes_xyxy_px, asked)


def frames(seeds: int, per_seed: int) -> Iterator[tuple[SynthFrame, float]]:
    """Yield frames spread over recordings of unseen seeds, with the image's scale."""
    for k in range(seeds):
        config = SceneConfig(seed=_FIRST_SEED + k, path=_PATHS[k % len(_PATHS)], depth_holes=False)
        renderer = SceneRenderer(config)
        for i in np.linspace(0, config.frames - 1, per_seed).astype(int):
            yield renderer.frame(int(i)), config.scale


def main(argv: Sequence[str] | None = None) -> None:
    """Print recall and precision by class, for people and for objects."""
    parser = argparse.ArgumentParser(description='Measure a detector on rendered scenes.')
    parser.add_argument('model', type=Path)
    parser.add_argument('--seeds', type=int, default=12)
    parser.add_argument('--frames', type=int, default=15, help='of each seed')
    parser.add_argument('--score', type=float, default=DetectorConfig().score_threshold)
    args = parser.parse_args(argv)
    cv2.setNumThreads(1)
    detector = OnnxDetector(args.model, DetectorConfig(score_threshold=args.score))
    tally, network_ms = Tally(), []
    for synth, scale in frames(args.seeds, args.frames):
        found = detector.detect(synth.frame.image_bgr, synth.frame.stamp_ns)
        network_ms.append(detector.network_ms)
        count(tally, truth_of(synth, scale), found)
    everything = set(tally.counts)
    rows = {name: tally.of(name) for name in sorted(everything)}
    rows['PEOPLE'] = tally.total({PERSON})
    rows['OBJECTS'] = tally.total(everything - {PERSON})
    print(f'{"class":15} {"asked":>6} {"recall":>7} {"precision":>10}')  # noqa: T201
    for name, c in rows.items():
        recall, precision = c.found / max(c.asked, 1), c.right / max(c.reported, 1)
        print(f'{name:15} {c.asked:6} {recall:7.3f} {precision:10.3f}')  # noqa: T201
    print(f'network: {np.median(network_ms):.1f} ms median')  # noqa: T201


if __name__ == '__main__':
    main()
