"""Perturbations of a recording or of its detections, for the robustness experiments."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np

from hoid_bags.sequence import Sequence
from hoid_benchmarks.plan.moving_picture import MovingPicture
from hoid_benchmarks.plan.plan import Perturbation
from hoid_benchmarks.plan.rearranged import Arrangement, RearrangedSequence
from hoid_bringup.run.detection_source import DetectionSource
from hoid_common.sync import Rate
from hoid_common.values import (
    PERSON,
    S_PER_NS,
    ByteArray,
    CameraModel,
    Detections,
    Float32Array,
    IntArray,
    RgbdFrame,
    Trajectory,
)

_FRAME_NS = 33_333_333
_MISSED_EVERY_NS = 3_000_000_000
_NS_PER_MS = 1_000_000
_REARRANGING = ('loops', 'cut_images', 'jump_back', 'keep_every', 'stamp_jitter_ms')
_COVER_PERIOD_S = 6.0
_COVER_DEPTH_M = 0.8
_FALSE_SCORE, _FALSE_SIDE = 0.28, 0.91  # score and relative size of false people of YOLOX-nano


class PerturbedSequence:
    """A sequence with perturbed frames; every iteration yields the same frames."""

    def __init__(self, recording: Sequence, perturbation: Perturbation, seed: int) -> None:
        self._base = base = _rearranged(recording, perturbation, seed)
        self._perturbation = perturbation
        self._seed = seed
        self._black = black_range(len(recording), perturbation)
        self._screen: MovingPicture | None = None
        if perturbation.screen_m > 0 and base.ground_truth is not None:
            self._screen = MovingPicture(base.camera, base.ground_truth, perturbation.screen_m)
        self.name = base.name
        camera = _halved(base.camera) if perturbation.half_size else base.camera
        self.camera: CameraModel = replace(
            camera,
            fx_px=camera.fx_px * perturbation.focal_factor,
            fy_px=camera.fy_px * perturbation.focal_factor,
        )
        self.ground_truth: Trajectory | None = base.ground_truth
        self.true_detections = base.true_detections
        self.fault = base.fault

    def __len__(self) -> int:
        """Return the number of images that are not black."""
        return len(self._base) - self._perturbation.black_images

    def __iter__(self) -> Iterator[RgbdFrame]:
        rng = np.random.default_rng(self._seed)
        texture = rng.integers(0, 255, (480, 640, 3), dtype=np.uint8)
        for n, frame in enumerate(self._base):
            if n in self._black:
                yield _black(frame)
            else:
                shown = frame if self._screen is None else self._screen.painted(frame)
                yield self._perturb(shown, rng, texture)

    def _perturb(
        self, frame: RgbdFrame, rng: np.random.Generator, texture: ByteArray
    ) -> RgbdFrame:
        p = self._perturbation
        depth_m, image = frame.depth_m, frame.image_bgr
        if p.half_size:
            # The mean of four depths at an edge would be on no surface.
            depth_m = depth_m[::2, ::2]
            image = np.asarray(
                cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8
            )
        if p.depth_noise > 0:
            noise = rng.standard_normal(depth_m.shape, np.float32) * p.depth_noise
            depth_m = np.where(depth_m > 0, np.maximum(depth_m + noise * depth_m**2, 0), 0)
        if p.depth_missing_share > 0:
            depth_m = np.where(rng.random(depth_m.shape) < p.depth_missing_share, 0, depth_m)
        if p.covered_share > 0:
            image, depth_m = self._covered(image, depth_m, frame.stamp_ns, texture)
        return replace(frame, image_bgr=image, depth_m=depth_m.astype(np.float32, copy=False))

    def _covered(
        self, image: ByteArray, depth_m: Float32Array, stamp_ns: int, texture: ByteArray
    ) -> tuple[ByteArray, Float32Array]:
        left, right = cover_columns(image.shape[1], self._perturbation.covered_share, stamp_ns)
        image, depth_m = image.copy(), depth_m.copy()
        image[:, left:right] = texture[: image.shape[0], : right - left]
        depth_m[:, left:right] = _COVER_DEPTH_M
        return image, depth_m


def _halved(camera: CameraModel) -> CameraModel:
    """Return the camera whose pixels are 2x2 pixels of another one; pixel centers are integers."""
    return replace(
        camera,
        width_px=camera.width_px // 2,
        height_px=camera.height_px // 2,
        fx_px=camera.fx_px / 2,
        fy_px=camera.fy_px / 2,
        cx_px=(camera.cx_px - 0.5) / 2,
        cy_px=(camera.cy_px - 0.5) / 2,
    )


def black_range(num_images: int, perturbation: Perturbation) -> range:
    """Return the indices of the black images of a recording."""
    first = _middle(num_images)
    return range(first, first + perturbation.black_images)


def _middle(count: int) -> int:
    return count // 2


def _black(frame: RgbdFrame) -> RgbdFrame:
    black, nothing = np.zeros_like(frame.image_bgr), np.zeros_like(frame.depth_m)
    return replace(frame, image_bgr=black, depth_m=nothing)


def _rearranged(recording: Sequence, perturbation: Perturbation, seed: int) -> Sequence:
    """Return a recording with the order and stamps of images that the perturbation requires."""
    p, rng = perturbation, np.random.default_rng(seed)
    plain = Perturbation()
    if all(getattr(p, name) == getattr(plain, name) for name in _REARRANGING):
        return recording

    def arrange(recorded_ns: IntArray) -> Arrangement:
        forth = np.arange(len(recorded_ns))
        order = np.concatenate([forth[:: -1 if k % 2 else 1] for k in range(p.loops)])
        stamps_ns = recorded_ns[0] + _FRAME_NS * np.arange(len(order) + p.jump_back)
        middle = _middle(len(forth))
        order = np.r_[order[:middle], order[middle - p.jump_back :]]
        seen = middle + p.black_images
        order = np.delete(order, slice(seen, seen + p.cut_images))
        if p.loops == 1 and not (p.jump_back or p.cut_images):
            stamps_ns = recorded_ns[order]
        kept = slice(0, len(order), p.keep_every)
        limit_ns = p.stamp_jitter_ms * _NS_PER_MS
        off_ns = rng.uniform(-limit_ns, limit_ns, len(order)).round().astype(np.int64)
        return Arrangement(order[kept], (stamps_ns[: len(order)] + off_ns)[kept])

    return RearrangedSequence(recording, arrange)


def cover_columns(width_px: int, share: float, stamp_ns: int) -> tuple[int, int]:
    """Return the first and end column (px) that the moving cover hides at a time."""
    wide = round(width_px * share)
    swing = 0.5 + 0.5 * np.sin(2 * np.pi * (stamp_ns * S_PER_NS) / _COVER_PERIOD_S)
    left = round((width_px - wide) * swing)
    return left, left + wide


def perturb_detections(
    detect: DetectionSource, perturbation: Perturbation, seed: int
) -> DetectionSource:
    """Return a perturbed detection source, which returns None while it is late or dead."""
    state = _Clock(np.random.default_rng(seed + 1))
    rate = Rate(perturbation.detector_hz)

    def perturbed(frame: RgbdFrame) -> Detections | None:
        if state.is_dead(frame.stamp_ns, perturbation.detector_dead_s):
            return None
        if not rate.take_due(frame.stamp_ns):
            return None
        if state.is_missed(frame.stamp_ns, perturbation):
            return Detections.none(frame.stamp_ns)
        found = detect(frame)
        if found is None:
            return None
        if perturbation.missed_people:
            found = _without_people(found, perturbation.missed_people, state.rng)
        if perturbation.extra_boxes:
            found = _with_extra(found, perturbation.extra_boxes, frame.depth_m.shape)
        if perturbation.covered_share:
            found = _with_cover(found, perturbation.covered_share, frame.depth_m.shape)
        if perturbation.false_every and state.num_asked % perturbation.false_every == 0:
            found = _with_false_person(found, frame.depth_m.shape)
        return found

    return perturbed


class _Clock:
    """Selects the frames that a perturbed detector processes."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self._first_ns: int | None = None
        self.num_asked = 0

    def is_dead(self, stamp_ns: int, after_s: float) -> bool:
        return 0 < after_s <= self._since_ns(stamp_ns) * S_PER_NS

    def _since_ns(self, stamp_ns: int) -> int:
        self._first_ns = stamp_ns if self._first_ns is None else self._first_ns
        return stamp_ns - self._first_ns

    def is_missed(self, stamp_ns: int, perturbation: Perturbation) -> bool:
        since_ns = self._since_ns(stamp_ns)
        in_run = since_ns % _MISSED_EVERY_NS < perturbation.missed_run * _FRAME_NS
        lost = self.rng.random() < perturbation.missed_share
        self.num_asked += 1
        if perturbation.missed_every > 0:
            lost |= self.num_asked % perturbation.missed_every == 0
        return bool(lost or (in_run and since_ns >= _MISSED_EVERY_NS))


def _without_people(found: Detections, share: float, rng: np.random.Generator) -> Detections:
    missed = rng.random(len(found)) < share
    is_person = np.array(found.class_names) == PERSON
    seen = np.flatnonzero(~(missed & is_person))
    return _among(found, found.boxes_xyxy_px, seen)


def _among(found: Detections, boxes_xyxy_px: Float32Array, seen: IntArray) -> Detections:
    names = tuple(found.class_names[n] for n in seen)
    return Detections(found.stamp_ns, boxes_xyxy_px[seen], names, found.scores[seen])


def _with_cover(found: Detections, share: float, shape_hw: tuple[int, ...]) -> Detections:
    left, right = cover_columns(shape_hw[1], share, found.stamp_ns)
    found = _not_hidden(found, left, right)
    return _with(found, np.array([[left, 0, right, shape_hw[0]]], np.float32), PERSON)


def _not_hidden(found: Detections, left: int, right: int) -> Detections:
    """Return the boxes of which at least half is visible, clipped at the hidden columns."""
    x1, x2 = found.boxes_xyxy_px[:, 0], found.boxes_xyxy_px[:, 2]
    first, last = np.stack([x1, np.maximum(x1, right)]), np.stack([np.minimum(x2, left), x2])
    side = np.argmax(last - first, axis=0)  # the wider of the two visible parts
    boxes = found.boxes_xyxy_px.copy()
    boxes[:, 0], boxes[:, 2] = (np.choose(side, ends) for ends in (first, last))
    seen = np.flatnonzero(boxes[:, 2] - boxes[:, 0] >= 0.5 * (x2 - x1))
    return _among(found, boxes, seen)


def _with_false_person(found: Detections, shape_hw: tuple[int, ...]) -> Detections:
    """Add a false person over most of the image, as small detectors sometimes report."""
    size_px = np.array(shape_hw[1::-1], np.float32)
    margin_px = size_px * (1 - _FALSE_SIDE) / 2
    box = np.concatenate([margin_px, size_px - margin_px])
    return _with(found, box[None].astype(np.float32), PERSON, _FALSE_SCORE)


def _with_extra(found: Detections, number: int, shape_hw: tuple[int, ...]) -> Detections:
    """Add small boxes of objects at random places."""
    rng = np.random.default_rng(found.stamp_ns % 2**32)
    size_px = rng.uniform(20, 60, (number, 2))
    corner = rng.uniform(0, 1, (number, 2)) * (np.array(shape_hw[1::-1]) - size_px)
    return _with(found, np.concatenate([corner, corner + size_px], 1).astype(np.float32), 'cup')


def _with(
    found: Detections, boxes_xyxy_px: Float32Array, name: str, score: float = 0.9
) -> Detections:
    number = len(boxes_xyxy_px)
    return Detections(
        found.stamp_ns,
        np.concatenate([found.boxes_xyxy_px, boxes_xyxy_px]),
        (*found.class_names, *[name] * number),
        np.concatenate([found.scores, np.full(number, score, np.float32)]),
    )
