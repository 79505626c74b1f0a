"""What is published of an image, and in which order: features, then what takes longer to know."""

from __future__ import annotations

from typing import NamedTuple

from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.values import Features
from hoid_filter.feature_filter import DetectedCorners, FeatureFilter
from hoid_filter.ros.outputs import FilterOutputs
from hoid_filter.ros.second_looks import FirstLook, SecondLooks

_MAX_UNSENSED = 3  # images in a row: of 30 a second, motion is still looked for in 7


class _Published(NamedTuple):
    look: FirstLook
    features: Features
    is_final: bool


class _Pending(NamedTuple):
    """An image in which motion is to be looked for, and what was published when it came."""

    detected: DetectedCorners
    published: _Published


class Looks:
    """Publishes what is known of images as they come, and the rest when motion is known, too."""

    def __init__(
        self,
        feature_filter: FeatureFilter,
        outputs: FilterOutputs,
        second_looks: SecondLooks,
        diagnostics: Diagnostics,
    ) -> None:
        self._filter, self._outputs = feature_filter, outputs
        self._second_looks, self._diagnostics = second_looks, diagnostics
        self._pending: _Pending | None = None
        self._num_unsensed = 0  # images since the last look for motion

    def forget(self) -> None:
        """Drop the image in which motion is to be looked for."""
        self._pending = None

    def take(self, look: FirstLook) -> None:
        """Publish an image; motion is looked for in it later."""
        if (
            self._pending is not None
            and self._pending.detected.frame.stamp_ns > look.frame.stamp_ns
        ):
            self.forget()  # stamps went back
        self._be_overtaken()
        detected = self._filter.detect_corners(look.frame)
        self._pending = _Pending(detected, self._publish(look, detected))

    def look_for_motion(self) -> None:
        """Look for motion in the image that came last, unless that has been done."""
        if self._pending is not None:
            (detected, published), self._pending = self._pending, None
            self._num_unsensed = 0
            self._filter.sense_motion(detected)
            self._follow_up(published)

    def _be_overtaken(self) -> None:
        """Say the rest of the last image: without a look for motion, mostly."""
        if self._num_unsensed == _MAX_UNSENSED:
            self.look_for_motion()
        elif self._pending is not None:
            self._num_unsensed += 1
            published, self._pending = self._pending.published, None
            self._follow_up(published)
            self._diagnostics.count('images without a look for motion')

    def _publish(self, look: FirstLook, detected: DetectedCorners) -> _Published:
        """Publish features by what is known by now."""
        result = self._filter.select_and_describe(
            detected, look.known.detections, for_picture=self._outputs.wants_picture
        )
        is_final = look.known.is_final and self._filter.is_motion_known(look.frame.stamp_ns)
        self._outputs.publish(look.frame, result, look.header, provisional=not is_final)
        return _Published(look, result.features, is_final)

    def _follow_up(self, published: _Published) -> None:
        """Publish masks where they are wanted, and have an image judged again that is to be."""
        look, features, is_final = published
        if self._outputs.wants_masks:
            depth_m = look.frame.depth_m
            word = self._filter.judge_again(features, depth_m, None)
            self._outputs.publish_masks(word, depth_m, look.header, self._filter.camera)
        if not is_final:
            self._second_looks.remember(look, features)
        self._diagnostics.count('images filtered')
        for name, number in self._filter.counters.items():
            self._diagnostics.set_count(name, number)
