"""The strategies that judge each image for itself: the HOID paper's rules and their neighbours."""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from hoid_common.values import PERSON, ByteArray, IntArray, Reason
from hoid_filter.config import FilterConfig
from hoid_filter.detections.aligned_detections import AlignedDetections, FilterInput, Verdict
from hoid_filter.detections.prediction import BoxPredictor
from hoid_filter.detections.sanitize import sanitize
from hoid_native import judge_boxes, sample_depths_m
from hoid_native.boxes import MAY_BE_HANDLED as ROLE_CANDIDATE
from hoid_native.boxes import PERSON as ROLE_PERSON

_CLASSES = 256  # of a detector, about
# Of `descriptor`: side of the window around a key point, and how near in depth a person is.
_WINDOW_PX, _NEAR_M = 40, 0.3
# Why a box moves, by its role; what does not move counts as without one.
_DETECTED = {0: Reason.STATIC, ROLE_PERSON: Reason.PERSON, ROLE_CANDIDATE: Reason.HANDLED}
_PREDICTED = {0: Reason.STATIC, ROLE_PERSON: Reason.PREDICTED, ROLE_CANDIDATE: Reason.PREDICTED}


class Rule(NamedTuple):
    """When a person handles an object."""

    min_share: float  # the person covers more than this share of the object's box ...
    apart_m: float  # ... and both are less than this apart in depth, or one depth is not known
    reach_px: float = math.nan  # instead of the share: a key point of the object is this near


class ImageRule(ABC):
    """Base of the rules without memory: people are dynamic, and objects as `rule` says."""

    def __init__(self, config: FilterConfig) -> None:
        self.config = config
        self._role_of = functools.lru_cache(_CLASSES)(self._role)
        self._predictor = BoxPredictor(config.prediction_limit_s)

    @abstractmethod
    def rule(self) -> Rule:
        """Return when a person handles an object."""

    def judge(self, view: FilterInput) -> Verdict:
        """Return the verdict on every detection."""
        scene = align_detections(view, self._predictor)
        found = scene.detections
        names = found.class_names
        judged = judge_boxes(
            view.depth_m,
            view.corner_pixels,
            found.boxes_xyxy_px,
            np.fromiter(map(self._role_of, names), np.uint8, len(names)),
            self.config.sample_box_px,
            *self.rule(),
        )
        return Verdict(
            boxes_xyxy_px=found.boxes_xyxy_px,
            class_names=names,
            scores=found.scores,
            track_ids=_no_tracks(len(names)),
            reasons=_reasons(judged.moves, scene.detected),
            overlap_ratios=judged.overlap,
            depths_m=judged.depth_m,
            depth_gaps_m=judged.gap_m,
            static_area_px=judged.area_px,
            kept=None if judged.area_px == view.depth_m.size else judged.outside,
        )

    def _role(self, class_name: str) -> int:
        if class_name == PERSON:
            return ROLE_PERSON
        return ROLE_CANDIDATE if self.config.may_be_handled(class_name) else 0


class NoFilter:
    """Takes everything for static, people too."""

    def __init__(self, config: FilterConfig) -> None:
        self._predictor = BoxPredictor(config.prediction_limit_s)
        self._sample_box_px = config.sample_box_px

    def judge(self, view: FilterInput) -> Verdict:
        """Return a verdict that keeps the whole image."""
        scene = align_detections(view, self._predictor)
        num = len(scene.detections)
        boxes = scene.detections.boxes_xyxy_px
        return Verdict(
            boxes_xyxy_px=boxes,
            class_names=scene.detections.class_names,
            scores=scene.detections.scores,
            track_ids=_no_tracks(num),
            reasons=(Reason.STATIC,) * num,
            overlap_ratios=np.zeros(num),
            depths_m=sample_depths_m(view.depth_m, boxes, self._sample_box_px),
            depth_gaps_m=np.full(num, np.nan),
            static_area_px=view.depth_m.size,
            kept=None,
        )


class PersonOnly(ImageRule):
    """Drops people's boxes and nothing else."""

    def rule(self) -> Rule:
        """Return that nobody handles anything."""
        return Rule(math.inf, math.inf)


class Hoid2d(ImageRule):
    """The paper's 2-D rule: a person covers more of the object than the limit."""

    def rule(self) -> Rule:
        """Return that the overlap is greater than the limit, at any depth."""
        return Rule(self.config.min_interaction_area, math.inf)


class Hoid3d(ImageRule):
    """The paper's 3-D rule: the 2-D rule, and the sample boxes are nearly equally far.

    Where a sample box has no reading the 2-D rule decides alone: a moving object taken for static
    harms the map, a static one taken for moving costs a few features.
    """

    def rule(self) -> Rule:
        """Return that overlap and depth both say so."""
        return Rule(self.config.min_interaction_area, self.config.depth_limit_m)


class Descriptor(ImageRule):
    """A semantic descriptor of key points, after Fang et al., Pattern Recognition 113 (2021).

    A square window around each key point of a movable object is searched: a person in it scores 1,
    the object itself 0. The object is dynamic when one of its windows shows both and they stand
    within the distance threshold of each other.
    """

    def rule(self) -> Rule:
        """Return that a key point of the object has the person in its window."""
        # At the distance itself they are still near.
        return Rule(math.inf, math.nextafter(_NEAR_M, math.inf), _WINDOW_PX / 2)


def align_detections(view: FilterInput, predictor: BoxPredictor) -> AlignedDetections:
    """Return the view with boxes of its own stamp, predicted where they are older or missing."""
    detections = view.detections
    detected = detections is not None and detections.stamp_ns == view.stamp_ns
    if detections is not None:
        predictor.observe(detections)
    if detections is None or not detected:
        height, width = view.depth_m.shape
        predicted = predictor.predict(view.stamp_ns)
        detections = sanitize(predicted, width, height, len(predicted)).detections
    return AlignedDetections(detections, detected)


def _no_tracks(num: int) -> IntArray:
    ids = np.empty(num, np.int64)
    ids.fill(-1)  # np.full takes three times as long
    return ids


def _reasons(moves: ByteArray, detected: bool) -> tuple[Reason, ...]:
    reason_of = _DETECTED if detected else _PREDICTED
    return tuple([reason_of[role] for role in moves.tolist()])
