"""The live filter: decides when images are published, re-evaluated and given a final verdict."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, Protocol

from hoid_common.errors import MessageError
from hoid_common.sync import RESTART_NS
from hoid_common.values import (
    NS_PER_S,
    CameraModel,
    Detections,
    Features,
    FilterResult,
    Float32Array,
    RgbdFrame,
)
from hoid_filter.config import STOP, DetectionInputConfig
from hoid_filter.feature_filter import DetectedCorners, FeatureFilter, FinalVerdict

# Chosen: on a busy processor, motion is still segmented in 7 of 30 images per second (decision
# 031).
_MAX_IMAGES_WITHOUT_MOTION = 3
_MAX_QUEUED = 30  # chosen: one second of images or detections
# Chosen, far above real delays. Detections may arrive before their image, whose depth image may be
# late. They are refused if their stamp is later than the newest image's by more than this time
# plus the time since that image arrived.
_MAX_LEAD_S = 1.0
_DETECTOR_LOST = 'detector lost'


class LiveOutputs(Protocol):
    """Publishes the results for an image, with the header of its color image message."""

    @property
    def wants_picture(self) -> bool: ...

    @property
    def wants_masks(self) -> bool: ...

    def publish(
        self, frame: RgbdFrame, result: FilterResult, header: Any, *, provisional: bool
    ) -> None:
        """Publish features and objects; if `provisional`, `publish_final` may follow."""

    def publish_final(
        self, final: FinalVerdict, header: Any, size_px: tuple[int, int]
    ) -> None: ...

    def publish_masks(
        self, final: FinalVerdict, depth_m: Float32Array, header: Any, camera: CameraModel | None
    ) -> None:
        """Publish masked images, and point clouds if `camera` is of the images' size."""


class LiveDiagnostics(Protocol):
    """The diagnostics of the node, which take counts and problems."""

    def count(self, name: str, number: int = 1) -> None: ...

    def set_count(self, name: str, number: int) -> None: ...

    def note(self, text: str, what: str) -> None: ...

    def set_problem(self, name: str, text: str, *, severe: bool) -> None: ...

    def clear_problem(self, name: str) -> None: ...


class _Held(NamedTuple):
    """An image that is not published yet, because the detector has sent no message."""

    header: Any
    frame: RgbdFrame
    since_s: float  # time of arrival on a steady clock


class _Published(NamedTuple):
    """The newest published image, in which motion has not been segmented yet."""

    header: Any
    corners: DetectedCorners
    features: Features
    detections: Detections | None
    has_final_detections: bool  # True: no later message of the detector can improve the detections
    is_final: bool  # whether the published verdict is final


class _Awaiting(NamedTuple):
    """A provisionally published image that waits for its own detections."""

    header: Any
    depth_m: Float32Array
    features: Features
    since_s: float  # time at which the wait began, on the steady clock


class LiveFilter:
    """State machine that publishes each image early, and its final classification later.

    An image passes these states in order, and skips those that it does not need. *Held*: it waits
    at most `wait_s` for the first message of the detector, because a map must not start with
    people in it. *Published*: its features are published with the boxes and moving regions known
    so far, provisionally if better ones may come. *Motion segmented*: when no message waits
    (`on_idle`) or detections arrive; at most three images in a row skip this state. *Awaiting
    detections*: it waits for those of this or a later image, until `wait_s` has passed, the
    detector is lost, or more than 30 images wait. *Final*: the final verdict on provisional
    features is published (decision 031).

    `request_idle` schedules a call of `on_idle` after all messages that have arrived by then.
    `clock` returns steady time in seconds.
    """

    def __init__(
        self,
        config: DetectionInputConfig,
        feature_filter: FeatureFilter,
        outputs: LiveOutputs,
        diagnostics: LiveDiagnostics,
        request_idle: Callable[[], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.config = config
        self._filter, self._outputs, self._diagnostics = feature_filter, outputs, diagnostics
        self._request_idle, self._clock = request_idle, clock
        self._has_published = False  # whether an image was published since the last `on_idle`
        self._num_without_motion = 0  # images in a row in which motion was not segmented
        self._clear()

    def _clear(self) -> None:
        self._held: deque[_Held] = deque()
        self._newest: _Published | None = None
        self._awaiting: deque[_Awaiting] = deque()
        self._unused_detections = _bounded()  # received, and kept for later images
        self._num_without_detections = 0  # number of images that never got detections of their own
        self._has_detector_answered = False  # whether detections have come since the stream began
        # Time of arrival of the first image after the last detections; None: no image since then.
        self._unanswered_since_s: float | None = None
        self._newest_image_s = 0.0  # time of arrival of the newest image, on the steady clock
        self._newest_image_ns: int | None = None  # stamp of the newest image

    def forget(self) -> None:
        self._filter.reset()
        self._clear()

    def add_image(self, header: Any, frame: RgbdFrame) -> None:
        """Publish an image now, or hold it until the detector has sent its first message.

        If the stamps go back by a second or more, all earlier images and objects are dropped.
        """
        newest_ns = self._newest_image_ns
        if newest_ns is not None and newest_ns - frame.stamp_ns >= RESTART_NS:
            self._restart(frame.stamp_ns)
        if not self._filter.needs_detections:
            self._newest_image_ns = frame.stamp_ns
            self._publish(header, frame, None, has_final_detections=True)
            return
        self._held.append(_Held(header, frame, self._clock()))
        self._publish_held()

    def add_detections(self, detections: Detections) -> None:
        """Publish the final classification of images that wait for these or older detections.

        Detections that no waiting image has used, or that are newer than the newest image, are
        stored for later images. MessageError if no image can have such a late stamp by now.
        """
        self.segment_motion()  # first, because the verdicts below are final and include motion
        self._check_lead(detections)
        self._unanswered_since_s, self._has_detector_answered = None, True
        answered = []
        while self._awaiting and self._awaiting[0].features.stamp_ns <= detections.stamp_ns:
            image = self._awaiting.popleft()
            if image.features.stamp_ns != detections.stamp_ns:
                self._num_without_detections += 1
            answered.append(image)
        newest_ns = self._newest_image_ns
        if not answered or newest_ns is None or detections.stamp_ns > newest_ns:
            self._unused_detections.append(detections)
        self._report_loss()
        self._finish(answered, detections)
        self._publish_held()

    def poll(self) -> None:
        """Publish the final classification of overdue images; call this often within `wait_s`."""
        overdue = []
        while self._awaiting and self._is_overdue(self._awaiting[0]):
            overdue.append(self._awaiting.popleft())
        self._num_without_detections += len(overdue)
        self._finish(overdue, None)
        self._publish_held()

    def on_idle(self) -> None:
        """Segment motion in the newest image, because no message waits.

        The first call after an image only requests another call: the next image may have arrived,
        and publishing its features has priority.
        """
        if self._has_published:
            self._has_published = False
            self._request_idle()
        else:
            self.segment_motion()

    def segment_motion(self) -> None:
        if self._newest is not None:
            image, self._newest = self._newest, None
            self._num_without_motion = 0
            self._filter.detect_motion(image.corners)
            self._follow_up(image)

    def _restart(self, stamp_ns: int) -> None:
        """Drop images, objects and detections of the stream that ended before `stamp_ns`."""
        self._awaiting.clear()
        self._held.clear()
        self._unused_detections = _bounded(self._unused_until(stamp_ns))
        self._has_detector_answered = bool(self._unused_detections)
        self._newest_image_s, self._newest_image_ns = self._clock(), stamp_ns
        self._unanswered_since_s = None
        self._filter.reset()
        text = 'the stamps went back, as where a bag starts again: all objects are forgotten'
        self._diagnostics.note(text, 'times that stamps went back')

    def _publish_held(self) -> None:
        """Publish at most one held image, because several would overflow the SLAM's queue."""
        if not self._held or self._must_wait(self._held[0]):
            return
        header, frame, _ = self._held.popleft()
        self._note_image(frame.stamp_ns)
        detections, is_final = self._take_detections(frame.stamp_ns)
        self._report_loss()
        if not self._is_stopped:
            self._publish(header, frame, detections, has_final_detections=is_final)

    def _must_wait(self, held: _Held) -> bool:
        is_first = not self._has_detector_answered and not self._is_detector_lost
        return is_first and self._clock() - held.since_s < self.config.wait_s

    def _note_image(self, stamp_ns: int) -> None:
        self._newest_image_s, self._newest_image_ns = self._clock(), stamp_ns
        if self._unanswered_since_s is None:
            self._unanswered_since_s = self._newest_image_s

    def _take_detections(self, stamp_ns: int) -> tuple[Detections | None, bool]:
        """Remove unused detections up to a stamp; return the newest, and whether they are final.

        They are final if detections of this or a later image have come, or the detector is lost.
        """
        is_answered = any(found.stamp_ns >= stamp_ns for found in self._unused_detections)
        past = self._unused_until(stamp_ns)
        self._unused_detections = _bounded(
            found for found in self._unused_detections if found.stamp_ns > stamp_ns
        )
        newest = max(past, key=lambda found: found.stamp_ns, default=None)
        is_own = newest is not None and newest.stamp_ns == stamp_ns
        is_final = is_answered or self._is_detector_lost
        if is_final and not is_own:
            self._num_without_detections += 1
        return newest, is_final

    def _unused_until(self, stamp_ns: int) -> list[Detections]:
        return [found for found in self._unused_detections if found.stamp_ns <= stamp_ns]

    def _publish(
        self,
        header: Any,
        frame: RgbdFrame,
        detections: Detections | None,
        *,
        has_final_detections: bool,
    ) -> None:
        self._has_published = True
        self._request_idle()
        self._overtake(frame.stamp_ns)
        corners = self._filter.detect_corners(frame)
        result = self._filter.select_and_describe(
            corners, detections, for_picture=self._outputs.wants_picture
        )
        is_final = has_final_detections and self._filter.is_motion_known(frame.stamp_ns)
        self._outputs.publish(frame, result, header, provisional=not is_final)
        self._newest = _Published(
            header, corners, result.features, detections, has_final_detections, is_final
        )

    def _overtake(self, stamp_ns: int) -> None:
        """Move the newest published image to its next state before a newer image replaces it."""
        if self._newest is not None and self._newest.features.stamp_ns > stamp_ns:
            self._newest = None  # the stamps went back
        if self._num_without_motion == _MAX_IMAGES_WITHOUT_MOTION:
            self.segment_motion()
        elif self._newest is not None:
            image, self._newest = self._newest, None
            self._num_without_motion += 1
            self._follow_up(image)
            self._diagnostics.count('images without motion segmentation')

    def _follow_up(self, image: _Published) -> None:
        depth_m = image.corners.frame.depth_m
        if self._outputs.wants_masks:
            verdict = self._filter.reevaluate(image.features, depth_m, None)
            self._outputs.publish_masks(verdict, depth_m, image.header, self._filter.camera)
        if not image.is_final:
            awaiting = _Awaiting(image.header, depth_m, image.features, self._clock())
            if image.has_final_detections:
                self._finish([awaiting], image.detections)
            else:
                self._awaiting.append(awaiting)
        self._diagnostics.count('images filtered')
        for name, number in self._filter.counters.items():
            self._diagnostics.set_count(name, number)

    def _finish(self, images: Iterable[_Awaiting], detections: Detections | None) -> None:
        for image in images:
            verdict = self._filter.reevaluate(image.features, image.depth_m, detections)
            height, width = image.depth_m.shape
            self._outputs.publish_final(verdict, image.header, (width, height))
        self._diagnostics.set_count('images without detections', self._num_without_detections)

    def _is_overdue(self, image: _Awaiting) -> bool:
        return (
            self._clock() - image.since_s >= self.config.wait_s
            or self._is_detector_lost
            or len(self._awaiting) > _MAX_QUEUED
        )

    def _check_lead(self, detections: Detections) -> None:
        if self._newest_image_ns is None:
            return
        lead_s = (detections.stamp_ns - self._newest_image_ns) / NS_PER_S
        if lead_s > self._clock() - self._newest_image_s + _MAX_LEAD_S:
            raise MessageError(
                f'detections are {lead_s:.1f} s ahead of the newest image: give them the stamp '
                'of their image'
            )

    @property
    def _silent_s(self) -> float:
        """Return the time (s) since images have come without detections; 0 = detections come."""
        since_s = self._unanswered_since_s
        return 0.0 if since_s is None else self._newest_image_s - since_s

    @property
    def _is_detector_lost(self) -> bool:
        return self._silent_s > self.config.timeout_s

    @property
    def _is_stopped(self) -> bool:
        return self.config.on_loss == STOP and self._is_detector_lost

    def _report_loss(self) -> None:
        if not self._is_detector_lost:
            self._diagnostics.clear_problem(_DETECTOR_LOST)
            return
        action = 'nothing is published' if self._is_stopped else 'features are unfiltered'
        self._diagnostics.set_problem(
            _DETECTOR_LOST,
            f'no detections for {self._silent_s:.1f} s: is the detector alive? {action}',
            severe=True,
        )


def _bounded(detections: Iterable[Detections] = ()) -> deque[Detections]:
    return deque(detections, maxlen=_MAX_QUEUED)
