"""Recall and precision of a detector on rendered scenes that training never uses.

Usage: python -m hoid_training.evaluate MODEL.onnx [--seeds N] [--frames N] [--score S]
It runs in the environment of the suite, without PyTorch.
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
from hoid_synth.truth import box_iou

MIN_VISIBLE_PX = 400  # at VGA; objects with fewer visible pixels need not be found
LARGE_PX = 32 * 32  # visible pixels at VGA from which an object is not "small" in COCO
_IOU = 0.5
_FIRST_SEED = 500
_PATHS = ('room', 'room', 'loop')


@dataclass
class Count:
    """Numbers of objects and detections of one class."""

    asked: int = 0  # objects that should be found, "asked" in the report
    found: int = 0
    large: int = 0  # large ones among them
    large_found: int = 0
    reported: int = 0
    right: int = 0  # detections that match an object, visible enough or not

    @property
    def recall(self) -> float:
        """Return the share of the objects that was found."""
        return self.found / max(self.asked, 1)

    @property
    def large_recall(self) -> float:
        """Return the share of the large objects that was found."""
        return self.large_found / max(self.large, 1)

    @property
    def precision(self) -> float:
        """Return the share of the detections that are correct."""
        return self.right / max(self.reported, 1)

    def __add__(self, other: Count) -> Count:
        return Count(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


@dataclass
class Tally:
    """Counts for each class."""

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
    """The true objects of one frame."""

    names: tuple[str, ...]
    boxes: Float32Array  # (N, 4)
    visible_px: FloatArray  # (N,) at VGA


def count(tally: Tally, truth: Truth, found: Detections, min_score: float = 0.0) -> None:
    """Match the detections of one frame to its objects in order of score, and count both."""
    overlap = box_iou(found.boxes_xyxy_px, truth.boxes)
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
    """Return the objects of a frame whose class is known to a detector."""
    seen = np.flatnonzero(np.isin(synth.detections.class_names, known))
    visible = np.bincount(synth.instance_image.ravel(), minlength=256)[list(synth.instances)]
    names = tuple(synth.detections.class_names[k] for k in seen)
    return Truth(names, synth.detections.boxes_xyxy_px[seen], visible[seen] / scale**2)


def scenes(number: int) -> list[SceneConfig]:
    """Return test scenes, whose seeds were not used to choose anything."""
    return [
        SceneConfig(seed=_FIRST_SEED + k, path=_PATHS[k % len(_PATHS)], depth_holes=False)
        for k in range(number)
    ]


def measure(
    detector: OnnxDetector, configs: Iterable[SceneConfig], frames_of_each: int
) -> tuple[Tally, float]:
    """Return the counts over frames of scenes, and the median time of the network in ms."""
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
    """Print recall and precision of each class, of people and of all objects."""
    parser = argparse.ArgumentParser(description='Measure a detector on rendered scenes.')
    parser.add_argument('model', type=Path)
    parser.add_argument('--seeds', type=int, default=24)
    parser.add_argument('--frames', type=int, default=15, help='frames of each seed')
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
