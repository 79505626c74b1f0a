"""Measures a detector on rendered scenes of seeds that training never uses.

Usage: python -m hoid_training.evaluate MODEL.onnx [--seeds N] [--frames N] [--score S]
It needs the suite's own environment only.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, field
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.values import PERSON, Detections, Float32Array, FloatArray
from hoid_detector.config import DetectorConfig
from hoid_detector.onnx_detector import OnnxDetector
from hoid_synth.config import SceneConfig
from hoid_synth.scene import SceneRenderer, SynthFrame

MIN_VISIBLE_PX = 400  # at VGA: an object of which less shows need not be found
LARGE_PX = 32 * 32  # visible, at VGA: not "small" in COCO's terms
_IOU = 0.5
_FIRST_SEED = 500
_PATHS = ('room', 'room', 'loop')


@dataclass
class Count:
    """Hits and misses of one class."""

    asked: int = 0  # objects that should be found
    found: int = 0
    large: int = 0  # of those
    large_found: int = 0
    reported: int = 0
    right: int = 0  # reports that fit an object, however little of it shows

    @property
    def recall(self) -> float:
        """Return the share that was found of what was asked for."""
        return self.found / max(self.asked, 1)

    @property
    def large_recall(self) -> float:
        """Return the share that was found of what is large."""
        return self.large_found / max(self.large, 1)

    @property
    def precision(self) -> float:
        """Return the share that is right of what was reported."""
        return self.right / max(self.reported, 1)

    def __add__(self, other: Count) -> Count:
        return Count(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


@dataclass
class Tally:
    """Counts by class."""

    counts: dict[str, Count] = field(default_factory=dict)

    def of(self, name: str) -> Count:
        """Return the count of a class."""
        return self.counts.setdefault(name, Count())

    def people(self) -> Count:
        """Return the count of people."""
        return self.of(PERSON)

    def objects(self) -> Count:
        """Return the sum over all other classes."""
        return sum((c for name, c in self.counts.items() if name != PERSON), Count())


class Truth(NamedTuple):
    """The objects of one frame."""

    names: tuple[str, ...]
    boxes: Float32Array  # (N, 4)
    visible_px: FloatArray  # (N,) at VGA


def overlaps(a: Float32Array, b: Float32Array) -> Float32Array:
    """Return (N, M) intersection over union."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    shared = np.maximum(high - low, 0).prod(-1)
    areas = [(x[:, 2:] - x[:, :2]).prod(-1) for x in (a, b)]
    return np.asarray(shared / np.maximum(areas[0][:, None] + areas[1][None] - shared, 1e-9))


def count(tally: Tally, truth: Truth, found: Detections, min_score: float = 0.0) -> None:
    """Match the detections of one frame to its objects, the strongest first."""
    overlap = overlaps(found.boxes_xyxy_px, truth.boxes)
    same = np.array([[a == b for b in truth.names] for a in found.class_names], bool)
    overlap = np.where(same.reshape(overlap.shape), overlap, 0)
    free = np.ones(len(truth.names), bool)
    for k in np.argsort(-found.scores, kind='stable'):
        if found.scores[k] < min_score:
            break
        c = tally.of(found.class_names[k])
        c.reported += 1
        row = overlap[k] * free
        if len(row) and row.max() >= _IOU:
            c.right += 1
            free[row.argmax()] = False
    for name, visible_px, missed in zip(truth.names, truth.visible_px, free, strict=True):
        if visible_px >= MIN_VISIBLE_PX:
            c, large = tally.of(name), visible_px >= LARGE_PX
            c.asked += 1
            c.found += int(not missed)
            c.large += int(large)
            c.large_found += int(large and not missed)


def truth_of(synth: SynthFrame, scale: float, known: tuple[str, ...]) -> Truth:
    """Return the objects of a frame that are of the classes that a detector knows."""
    seen = np.flatnonzero(np.isin(synth.detections.class_names, known))
    visible = np.bincount(synth.instance_image.ravel(), minlength=256)[list(synth.instances)]
    names = tuple(synth.detections.class_names[k] for k in seen)
    return Truth(names, synth.detections.boxes_xyxy_px[seen], visible[seen] / scale**2)


def scenes(number: int) -> list[SceneConfig]:
    """Return what to render: seeds that nothing was chosen by."""
    return [
        SceneConfig(seed=_FIRST_SEED + k, path=_PATHS[k % len(_PATHS)], depth_holes=False)
        for k in range(number)
    ]


def measure(
    detector: OnnxDetector, configs: Iterable[SceneConfig], frames_of_each: int
) -> tuple[Tally, float]:
    """Return counts over frames spread over scenes, and the network's median time in ms."""
    tally, network_ms = Tally(), []
    for config in configs:
        renderer = SceneRenderer(config)
        for i in np.linspace(0, config.frames - 1, frames_of_each).astype(int):
            synth = renderer.frame(int(i))
            found = detector.detect(synth.frame.image_bgr, synth.frame.stamp_ns)
            network_ms.append(detector.network_ms)
            count(tally, truth_of(synth, config.scale, detector.class_names), found)
    return tally, float(np.median(network_ms))


def main(argv: Sequence[str] | None = None) -> None:
    """Print recall and precision by class, for people and for objects."""
    parser = argparse.ArgumentParser(description='Measure a detector on rendered scenes.')
    parser.add_argument('model', type=Path)
    parser.add_argument('--seeds', type=int, default=24)
    parser.add_argument('--frames', type=int, default=15, help='of each seed')
    parser.add_argument('--score', type=float, default=DetectorConfig().score_threshold)
    args = parser.parse_args(argv)
    cv2.setNumThreads(1)
    detector = OnnxDetector(args.model, DetectorConfig(score_threshold=args.score))
    tally, network_ms = measure(detector, scenes(args.seeds), args.frames)
    rows = {name: tally.of(name) for name in sorted(tally.counts)}
    rows['PEOPLE'], rows['OBJECTS'] = tally.people(), tally.objects()
    print(f'{"class":15} {"asked":>6} {"recall":>7} {"of large":>9} {"precision":>10}')  # noqa: T201
    for name, c in rows.items():
        values = f'{c.recall:7.3f} {c.large_recall:9.3f} {c.precision:10.3f}'
        print(f'{name:15} {c.asked:6} {values}')  # noqa: T201
    print(f'network: {network_ms:.1f} ms median')  # noqa: T201


if __name__ == '__main__':
    main()
