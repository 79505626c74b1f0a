"""Images that went out before their own detections were there, and are judged again with them."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from std_msgs.msg import Header

from hoid_common.errors import MessageError
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.values import (
    Detections,
    DynamicObject,
    Features,
    FeatureVerdicts,
    FilterResult,
    Float32Array,
    RgbdFrame,
)
from hoid_filter.detections.detection_gate import Answered, DetectionGate, GateConfig, Known
from hoid_filter.feature_filter import FeatureFilter, FinalWord
from hoid_filter.ros.outputs import FilterOutputs

_LOST = 'detector lost'


class _Provisional(NamedTuple):
    header: Header
    depth_m: Float32Array
    features: Features
    objects: tuple[DynamicObject, ...]


class SecondLooks:
    """Says what is known of an image as it comes, and publishes the final word when it can."""

    def __init__(
        self,
        config: GateConfig,
        feature_filter: FeatureFilter,
        outputs: FilterOutputs,
        diagnostics: Diagnostics,
    ) -> None:
        self._filter, self._outputs, self._diagnostics = feature_filter, outputs, diagnostics
        self._gate: DetectionGate[_Provisional] = DetectionGate(config)

    def reconfigure(self, config: GateConfig) -> None:
        """Take over parameters that may change at run time."""
        self._gate.config = config

    def forget(self) -> None:
        """Drop the images that are to be judged again."""
        self._gate = DetectionGate(self._gate.config)

    def known(self, stamp_ns: int) -> Known | None:
        """Take note of an image; None when nothing is to be published without a detector."""
        if self._gate.restart_if_back(stamp_ns):
            self._filter.reset()
            error = MessageError('stamps went back by a second or more: all objects are forgotten')
            self._diagnostics.report(error, 'times that stamps went back')
        known = self._gate.add_image(stamp_ns, time.monotonic())
        self._say_loss()
        return None if self._gate.is_shut else known

    def remember(self, header: Header, frame: RgbdFrame, result: FilterResult) -> None:
        """Judge an image again later that has just been published."""
        image = _Provisional(header, frame.depth_m, result.features, result.objects)
        self._gate.remember(frame.stamp_ns, image, time.monotonic())

    def add_detections(self, detections: Detections) -> None:
        """Judge again what was waiting for them; may raise MessageError."""
        answered = self._gate.add_detections(detections, time.monotonic())
        self._say_loss()
        self._answer(answered)

    def poll(self) -> None:
        """Give up on detections that are too late."""
        self._answer(self._gate.poll(time.monotonic()))

    def _answer(self, answered: list[Answered[_Provisional]]) -> None:
        for image, detections in answered:
            if detections is None:  # what was said at first holds
                nothing = np.zeros(len(image.features), np.bool_)
                verdicts = FeatureVerdicts(image.features.stamp_ns, nothing)
                word = FinalWord(image.objects, verdicts)
            else:
                word = self._filter.judge_again(image.features, image.depth_m, detections)
            height, width = image.depth_m.shape
            self._outputs.publish_final(word, image.header, (width, height))
        self._diagnostics.set_count('images without detections', self._gate.num_unanswered)

    def _say_loss(self) -> None:
        if not self._gate.is_lost:
            self._diagnostics.clear_problem(_LOST)
            return
        then = 'stopped' if self._gate.is_shut else 'features are unfiltered'
        self._diagnostics.set_problem(
            _LOST,
            f'no detections for {self._gate.silent_s:.1f} s: is the detector alive? {then}',
            severe=True,
        )
