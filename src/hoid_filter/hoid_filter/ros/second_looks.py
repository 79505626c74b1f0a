"""Images that go out before all is known of them, and are judged again when it is."""

from __future__ import annotations

import time
from collections import deque
from typing import NamedTuple

from std_msgs.msg import Header

from hoid_common.errors import MessageError
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.values import (
    Detections,
    Features,
    Float32Array,
    RgbdFrame,
)
from hoid_filter.detections.detection_gate import Answered, DetectionGate, GateConfig, Known
from hoid_filter.feature_filter import FeatureFilter
from hoid_filter.ros.outputs import FilterOutputs

_LOST = 'detector lost'


class _Provisional(NamedTuple):
    header: Header
    depth_m: Float32Array
    features: Features


class FirstLook(NamedTuple):
    """An image that is to be published now, and what is known of it."""

    header: Header
    frame: RgbdFrame
    known: Known


class _Held(NamedTuple):
    header: Header
    frame: RgbdFrame
    since_s: float


class SecondLooks:
    """Says what is known of an image as it comes, and publishes the final word when it can.

    Only the first images wait, until the detector has answered once: there is nothing to predict
    boxes from, and a map that begins with people has nothing to tell them by. Nothing is done with
    them until then, so that the detector has the processor.
    """

    def __init__(
        self,
        config: GateConfig,
        feature_filter: FeatureFilter,
        outputs: FilterOutputs,
        diagnostics: Diagnostics,
    ) -> None:
        self._filter, self._outputs, self._diagnostics = feature_filter, outputs, diagnostics
        self._gate: DetectionGate[_Provisional] = DetectionGate(config)
        self._held: deque[_Held] = deque()

    def reconfigure(self, config: GateConfig) -> None:
        """Take over parameters that may change at run time."""
        self._gate.config = config

    def forget(self) -> None:
        """Drop the images that are to be judged, or judged again."""
        self._gate = DetectionGate(self._gate.config)
        self._held.clear()

    def add_image(self, header: Header, frame: RgbdFrame) -> FirstLook | None:
        """Take an image and return the image to be published now."""
        if self._gate.restart_if_back(frame.stamp_ns):
            self._filter.reset()
            self._held.clear()
            error = MessageError('stamps went back by a second or more: all objects are forgotten')
            self._diagnostics.report(error, 'times that stamps went back')
        self._held.append(_Held(header, frame, time.monotonic()))
        return self._due()

    def remember(self, look: FirstLook, features: Features) -> None:
        """Judge an image again that was published, now or when its detections are there."""
        image = _Provisional(look.header, look.frame.depth_m, features)
        if look.known.is_final:
            self._answer([Answered(image, look.known.detections)])
        else:
            self._gate.remember(features.stamp_ns, image, time.monotonic())

    def add_detections(self, detections: Detections) -> FirstLook | None:
        """Judge again what was waiting for them, and return the image to be published now.

        Raises:
            MessageError: They are of a later image than can have been taken by now.
        """
        answered = self._gate.add_detections(detections, time.monotonic())
        self._say_loss()
        self._answer(answered)
        return self._due()

    def poll(self) -> FirstLook | None:
        """Give up on detections that are too late, and return the image to be published now."""
        self._answer(self._gate.poll(time.monotonic()))
        return self._due()

    def _due(self) -> FirstLook | None:
        """Return the next image if it need not wait: one at a time, as SLAM's queue is short."""
        if not self._held or self._must_wait(self._held[0]):
            return None
        header, frame, _ = self._held.popleft()
        known = self._gate.add_image(frame.stamp_ns, time.monotonic())
        self._say_loss()
        return None if self._gate.is_shut else FirstLook(header, frame, known)

    def _must_wait(self, held: _Held) -> bool:
        waited_s = time.monotonic() - held.since_s
        return self._gate.is_blind and waited_s < self._gate.config.wait_s

    def _answer(self, answered: list[Answered[_Provisional]]) -> None:
        for image, detections in answered:
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
