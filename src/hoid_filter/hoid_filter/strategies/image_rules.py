"""Strategies that classify each image separately: the rules of the HOID paper, and baselines."""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import numpy as np

from hoid_common.values import PERSON, Detections, ObjectState
from hoid_filter.config import FilterConfig
from hoid_filter.detections.prediction import BoxPredictor
from hoid_filter.detections.sanitize import sanitize
from hoid_filter.strategy import FilterInput, ObjectVerdicts, Verdict
from hoid_native import classify_boxes
from hoid_native.boxes import MAY_BE_HANDLED as ROLE_CANDIDATE
from hoid_native.boxes import PERSON as ROLE_PERSON

_MAX_CLASSES = 256  # chosen: number of cached class names; detectors for COCO have 80
# Of the semantic descriptor: side of the window around a keypoint, and largest depth difference.
# Chosen, not tuned: the strategy is a baseline of the experiments.
_WINDOW_PX, _MAX_DEPTH_GAP_M = 40, 0.3
# The state of a detected object by the role of its box; a static box has role 0.
_DETECTED = {
    0: ObjectState.AT_REST,
    ROLE_PERSON: ObjectState.PERSON,
    ROLE_CANDIDATE: ObjectState.HANDLED,
}
_PREDICTED = {
    0: ObjectState.AT_REST,
    ROLE_PERSON: ObjectState.PREDICTED,
    ROLE_CANDIDATE: ObjectState.PREDICTED,
}


class Rule(NamedTuple):
    """The condition under which a person handles an object."""

    min_overlap: float  # the person's box covers more than this ratio of the object's box
    max_depth_gap_m: float  # and their depths differ by less than this, or a depth is unknown
    # If it is not NaN, it replaces `min_overlap`: at least one FAST corner must lie in the
    # object's box, and at most this far outside the person's box along rows and columns.
    reach_px: float = math.nan


class ImageRule(ABC):
    """Base of strategies that classify each image separately: people and handled objects move."""

    needs_detections, senses_motion = True, False
    person_role: ClassVar[int] = ROLE_PERSON

    def __init__(self, config: FilterConfig) -> None:
        self.config = config
        self._role_of = functools.lru_cache(_MAX_CLASSES)(self._role)
        self._predictor = BoxPredictor(config.prediction_limit_s)

    @abstractmethod
    def rule(self) -> Rule:
        """Return the condition under which a person handles an object."""

    def classify(self, image: FilterInput) -> Verdict:
        found = self._boxes_at(image)
        names = found.class_names
        state_of = _DETECTED if found is image.detections else _PREDICTED
        judged = classify_boxes(
            image.depth_m,
            image.corner_pixels,
            found.boxes_xyxy_px,
            np.fromiter(map(self._role_of, names), np.uint8, len(names)),
            self.config.sample_box_px,
            *self.rule(),
        )
        objects = ObjectVerdicts.of(
            found.boxes_xyxy_px,
            names,
            found.scores,
            tuple([state_of[role] for role in judged.moves.tolist()]),
            overlap_ratios=judged.overlap,
            depths_m=judged.depth_m,
            depth_gaps_m=judged.gap_m,
        )
        kept = None if judged.area_px == image.depth_m.size else judged.outside
        return Verdict(objects, judged.area_px, kept)

    def _boxes_at(self, image: FilterInput) -> Detections:
        """Return the boxes at the stamp of an image: detected in it, or else predicted."""
        detections = image.detections
        if detections is not None:
            self._predictor.observe(detections)
            if detections.stamp_ns == image.stamp_ns:
                return detections
        height, width = image.depth_m.shape
        predicted = self._predictor.predict(image.stamp_ns)
        return sanitize(predicted, width, height, len(predicted)).detections

    def _role(self, class_name: str) -> int:
        if class_name == PERSON:
            return self.person_role
        return ROLE_CANDIDATE if self.config.may_be_handled(class_name) else 0


class PersonOnly(ImageRule):
    """Removes the features inside the boxes of people, and keeps all others."""

    def rule(self) -> Rule:
        return Rule(math.inf, math.inf)


class NoFilter(PersonOnly):
    """Keeps all features, also those on people."""

    needs_detections, person_role = False, 0


class Hoid2d(ImageRule):
    """The paper's 2-D rule: a person's box covers more than a ratio of the object's box."""

    def rule(self) -> Rule:
        return Rule(self.config.min_interaction_area, math.inf)


class Hoid3d(ImageRule):
    """The paper's 3-D rule: the 2-D rule holds, and person and object have nearly the same depth.

    An unknown depth counts as near, because a moving object harms the map, while masking a static
    object only costs a few features.
    """

    def rule(self) -> Rule:
        return Rule(self.config.min_interaction_area, self.config.depth_limit_m)


class Descriptor(ImageRule):
    """The semantic descriptor of keypoints by Fang et al., Pattern Recognition 113 (2021).

    An object is dynamic when a person's box reaches into the square window around any keypoint on
    it, at nearly the same depth.
    """

    def rule(self) -> Rule:
        return Rule(math.inf, math.nextafter(_MAX_DEPTH_GAP_M, math.inf), _WINDOW_PX / 2)
