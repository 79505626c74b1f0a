"""The strategies that judge each image for itself: the HOID paper's rules and their neighbours."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.values import BoolArray, FloatArray, Reason
from hoid_filter.config import FilterConfig
from hoid_filter.overlap import overlap_ratios
from hoid_filter.prediction import BoxPredictor
from hoid_filter.sanitize import sanitize
from hoid_filter.scene import Scene, Verdict, View, box_mask


class Interaction(NamedTuple):
    """How each of N detections stands to each of the M people among them."""

    scene: Scene
    overlap: FloatArray  # (N, M), share of the object's box
    depth_gap_m: FloatArray  # (N, M), NaN = unknown


class ImageRule(ABC):
    """Base of the rules without memory: people are dynamic, objects as `is_handled` says."""

    def __init__(self, config: FilterConfig) -> None:
        self.config = config
        self._predictor = BoxPredictor(config.prediction_limit_s)

    @abstractmethod
    def is_handled(self, interaction: Interaction) -> BoolArray:
        """Return the (N, M) flags of object and person who interact."""

    def judge(self, view: View) -> Verdict:
        """Return the verdict on every detection."""
        scene = scene_of(view, self._predictor, self.config.sample_box_px)
        boxes = scene.detections.boxes_xyxy_px
        is_person = scene.is_person
        interaction = measure(scene)
        pairs = self.is_handled(interaction)
        handled = pairs.any(axis=1) & self._is_candidate(scene)
        overlap, gap_m = most_telling(interaction, pairs)
        dynamic = is_person | handled
        return Verdict(
            boxes_xyxy_px=boxes,
            class_names=scene.detections.class_names,
            scores=scene.detections.scores,
            track_ids=np.full(len(boxes), -1, np.int64),
            reasons=_reasons(is_person, handled, scene.detected),
            overlap_ratios=np.where(is_person, 0.0, overlap),
            depths_m=scene.depths_m,
            depth_gaps_m=np.where(is_person, np.nan, gap_m),
            keep_mask=box_mask(boxes[dynamic], *scene.depth_m.shape) if dynamic.any() else None,
        )

    def _is_candidate(self, scene: Scene) -> BoolArray:
        names = scene.detections.class_names
        return np.fromiter(map(self.config.may_be_handled, names), np.bool_, len(names))


class NoFilter:
    """Takes everything for static, people too."""

    def __init__(self, config: FilterConfig) -> None:
        self._predictor = BoxPredictor(config.prediction_limit_s)
        self._sample_box_px = config.sample_box_px

    def judge(self, view: View) -> Verdict:
        """Return a verdict that keeps the whole image."""
        scene = scene_of(view, self._predictor, self._sample_box_px)
        num = len(scene.detections)
        return Verdict(
            boxes_xyxy_px=scene.detections.boxes_xyxy_px,
            class_names=scene.detections.class_names,
            scores=scene.detections.scores,
            track_ids=np.full(num, -1, np.int64),
            reasons=(Reason.STATIC,) * num,
            overlap_ratios=np.zeros(num),
            depths_m=scene.depths_m,
            depth_gaps_m=np.full(num, np.nan),
            keep_mask=None,
        )


class PersonOnly(ImageRule):
    """Drops people's boxes and nothing else."""

    def is_handled(self, interaction: Interaction) -> BoolArray:
        """Return no interaction at all."""
        return np.zeros(interaction.overlap.shape, np.bool_)


class Hoid2d(ImageRule):
    """The paper's 2-D rule: a person covers more of the object than the limit."""

    def is_handled(self, interaction: Interaction) -> BoolArray:
        """Return where the overlap is greater than the limit."""
        covered: BoolArray = interaction.overlap > self.config.min_interaction_area
        return covered


class Hoid3d(ImageRule):
    """The paper's 3-D rule: the 2-D rule, and the sample boxes are nearly equally far.

    Where a sample box has no reading the 2-D rule decides alone: a moving object taken for static
    harms the map, a static one taken for moving costs a few features.
    """

    def is_handled(self, interaction: Interaction) -> BoolArray:
        """Return where overlap and depth both say so."""
        covered = interaction.overlap > self.config.min_interaction_area
        apart: BoolArray = interaction.depth_gap_m >= self.config.depth_limit_m  # NaN: not apart
        return covered & ~apart


class Descriptor(ImageRule):
    """A semantic descriptor of key points, after Fang et al., Pattern Recognition 113 (2021).

    A square window around each key point of a movable object is searched: a person in it scores 1,
    the object itself 0. The object is dynamic when one of its windows shows both and they stand
    within the distance threshold of each other.
    """

    def is_handled(self, interaction: Interaction) -> BoolArray:
        """Return where a key point of the object has the person in its window."""
        scene = interaction.scene
        boxes = scene.detections.boxes_xyxy_px.astype(np.float64)
        reach = self.config.descriptor.window_px / 2
        people = boxes[scene.is_person] + [-reach, -reach, reach, reach]
        first = np.maximum(boxes[:, None, :2], people[None, :, :2])
        last = np.minimum(boxes[:, None, 2:], people[None, :, 2:])
        meets = _count_corners(scene, first, last) > 0
        apart: BoolArray = interaction.depth_gap_m > self.config.descriptor.distance_m
        return meets & ~apart


def _count_corners(scene: Scene, first: FloatArray, last: FloatArray) -> FloatArray:
    """Return the corners with first <= (u, v) < last, for corner points (..., 2) of boxes."""
    height, width = scene.depth_m.shape
    present = np.zeros(height * width, np.uint8)
    present[scene.corner_pixels] = 1
    total = cv2.integral(present.reshape(height, width))
    x1, y1 = np.moveaxis(np.clip(np.ceil(first), 0, [width, height]).astype(np.int64), -1, 0)
    x2, y2 = np.moveaxis(np.clip(np.ceil(last), 0, [width, height]).astype(np.int64), -1, 0)
    x2, y2 = np.maximum(x1, x2), np.maximum(y1, y2)
    count: FloatArray = total[y2, x2] - total[y1, x2] - total[y2, x1] + total[y1, x1]
    return count


def scene_of(view: View, predictor: BoxPredictor, sample_box_px: int) -> Scene:
    """Return the view with boxes of its own stamp, predicted where they are older or missing."""
    heard = view.heard
    detected = heard is not None and heard.stamp_ns == view.stamp_ns
    if heard is not None:
        predictor.observe(heard)
    if heard is None or not detected:
        height, width = view.depth_m.shape
        predicted = predictor.predict(view.stamp_ns)
        heard = sanitize(predicted, width, height, len(predicted)).detections
    return Scene(heard, detected, view.depth_m, view.corner_pixels, sample_box_px)


def measure(scene: Scene) -> Interaction:
    """Return how every detection (N) stands to every person among them (M)."""
    boxes = scene.detections.boxes_xyxy_px
    people = scene.is_person
    gaps_m: FloatArray = np.abs(scene.depths_m[:, None] - scene.depths_m[people][None])
    return Interaction(scene, overlap_ratios(boxes, boxes[people]), gaps_m)


def most_telling(interaction: Interaction, handled: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return each object's (N,) overlap with and depth gap to one person.

    It is the one who handles it, given (N, M) `handled`, and who covers most of it.
    """
    num, num_people = interaction.overlap.shape
    if num_people == 0:
        return np.zeros(num), np.full(num, np.nan)
    index, best = np.arange(num), (interaction.overlap + handled).argmax(axis=1)
    return interaction.overlap[index, best], interaction.depth_gap_m[index, best]


def _reasons(is_person: BoolArray, handled: BoolArray, detected: bool) -> tuple[Reason, ...]:
    person = Reason.PERSON if detected else Reason.PREDICTED
    other = Reason.HANDLED if detected else Reason.PREDICTED
    return tuple(
        person if p else other if h else Reason.STATIC
        for p, h in zip(is_person.tolist(), handled.tolist(), strict=True)
    )
