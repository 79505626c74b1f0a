"""Harder versions of a recording or of its detections, for the robustness curves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hoid_bags.sequence import Sequence
from hoid_benchmarks.plan import Perturbation
from hoid_bringup.detection_source import DetectionSource
from hoid_common.values import (
    PERSON,
    ByteArray,
    CameraModel,
    Detections,
    Float32Array,
    RgbdFrame,
    Trajectory,
)

_FRAME_NS = 33_333_333
_MISSED_EVERY_NS = 3_000_000_000
_COVER_PERIOD_S = 6.0
_COVER_DEPTH_M = 0.8


class PerturbedSequence:
    """A sequence whose frames are made harder, the same way at each iteration."""

    def __init__(self, base: Sequence, perturbation: Perturbation, seed: int) -> None:
        self._base = base
        self._perturbation = perturbation
        self._seed = seed
        self.name = base.name
        self.camera: CameraModel = base.camera
        self.ground_truth: Trajectory | None = base.ground_truth
        self.true_detections = base.true_detections
        self.fault = base.fault

    def __len__(self) -> int:
        return len(self._base) * self._perturbation.loops

    def __iter__(self) -> Iterator[RgbdFrame]:
        rng = np.random.default_rng(self._seed)
        texture = rng.integers(0, 255, (480, 640, 3), dtype=np.uint8)
        for frame in self._looped():
            yield self._harder(frame, rng, texture)

    def _looped(self) -> Iterator[RgbdFrame]:
        """Yield the frames forth, back, forth …, with stamps that go on."""
        if self._perturbation.loops == 1:
            yield from self._base
            return
        frames = list(self._base)
        for k in range(self._perturbation.loops):
            for i, frame in enumerate(frames[:: -1 if k % 2 else 1]):
                number = k * len(frames) + i
                yield replace(frame, stamp_ns=frames[0].stamp_ns + number * _FRAME_NS)

    def _harder(self, frame: RgbdFrame, rng: np.random.Generator, texture: ByteArray) -> RgbdFrame:
        p = self._perturbation
        depth_m, image = frame.depth_m, frame.image_bgr
        if p.depth_noise > 0:
            noise = rng.standard_normal(depth_m.shape, np.float32) * p.depth_noise
            depth_m = np.where(depth_m > 0, np.maximum(depth_m + noise * depth_m**2, 0), 0)
        if p.depth_missing_share > 0:
            depth_m = np.where(rng.random(depth_m.shape) < p.depth_missing_share, 0, depth_m)
        if p.covered_share > 0:
            image, depth_m = self._covered(image, depth_m, frame.stamp_ns, texture)
        return replace(frame, image_bgr=image, depth_m=depth_m.astype(np.float32))

    def _covered(
        self, image: ByteArray, depth_m: Float32Array, stamp_ns: int, texture: ByteArray
    ) -> tuple[ByteArray, Float32Array]:
        left, right = cover_columns(image.shape[1], self._perturbation.covered_share, stamp_ns)
        image, depth_m = image.copy(), depth_m.copy()
        image[:, left:right] = texture[: image.shape[0], : right - left]
        depth_m[:, left:right] = _COVER_DEPTH_M
        return image, depth_m


def cover_columns(width_px: int, share: float, stamp_ns: int) -> tuple[int, int]:
    """Return the columns that the moving cover hides at a time."""
    wide = round(width_px * share)
    swing = 0.5 + 0.5 * np.sin(2 * np.pi * (stamp_ns * 1e-9) / _COVER_PERIOD_S)
    left = round((width_px - wide) * swing)
    return left, left + wide


def perturb_detections(
    detect: DetectionSource, perturbation: Perturbation, seed: int
) -> DetectionSource:
    """Return a source that misses frames or runs slowly; None is what a late detector gives."""
    state = _Clock(np.random.default_rng(seed + 1))

    def perturbed(frame: RgbdFrame) -> Detections | None:
        if not state.is_due(frame.stamp_ns, perturbation.detector_hz):
            return None
        if state.is_missed(frame.stamp_ns, perturbation):
            return Detections.none(frame.stamp_ns)
        found = detect(frame)
        if found is None or perturbation.covered_share == 0:
            return found
        height_px, width_px = frame.depth_m.shape
        return _with_cover(found, perturbation.covered_share, width_px, height_px)

    return perturbed


class _Clock:
    """Decides which frames a made-worse detector sees."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._last_ns = -_MISSED_EVERY_NS
        self._first_ns: int | None = None
        self._num_asked = 0

    def is_due(self, stamp_ns: int, rate_hz: float) -> bool:
        due = rate_hz <= 0 or (stamp_ns - self._last_ns) * 1e-9 > 0.999 / rate_hz
        if due:
            self._last_ns = stamp_ns
        return due

    def is_missed(self, stamp_ns: int, perturbation: Perturbation) -> bool:
        self._first_ns = stamp_ns if self._first_ns is None else self._first_ns
        since_ns = stamp_ns - self._first_ns
        in_run = since_ns % _MISSED_EVERY_NS < perturbation.missed_run * _FRAME_NS
        lost = self._rng.random() < perturbation.missed_share
        self._num_asked += 1
        if perturbation.missed_every > 0:
            lost |= self._num_asked % perturbation.missed_every == 0
        return bool(lost or (in_run and since_ns >= _MISSED_EVERY_NS))


def _with_cover(found: Detections, share: float, width_px: int, height_px: int) -> Detections:
    left, right = cover_columns(width_px, share, found.stamp_ns)
    box = np.array([[left, 0, right, height_px]], np.float32)
    return Detections(
        found.stamp_ns,
        np.concatenate([found.boxes_xyxy_px, box]),
        (*found.class_names, PERSON),
        np.concatenate([found.scores, np.array([0.9], np.float32)]),
    )
