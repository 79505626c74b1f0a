"""A live filter whose images, detections and clock are those of a test."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from hoid_common.errors import HoidError
from hoid_common.values import (
    CameraModel,
    Detections,
    Features,
    FilterResult,
    Float32Array,
    RgbdFrame,
)
from hoid_filter.config import DetectionInputConfig
from hoid_filter.feature_filter import DetectedCorners, FeatureFilter, FinalVerdict
from hoid_filter.live_filter import LiveFilter

MS = 1_000_000
S = 1_000_000_000
Row = tuple[int, int | None]  # stamps of an image and of the detections it is classified with


class FakeCorners:
    """The frame of an image, without corners."""

    def __init__(self, frame: RgbdFrame) -> None:
        self.frame = frame


class FakeResult:
    """The stamps of an image and of its detections, in place of features or a final verdict."""

    def __init__(self, stamp_ns: int, detections: Detections | None) -> None:
        self.stamp_ns = stamp_ns
        self.row: Row = (stamp_ns, None if detections is None else detections.stamp_ns)

    @property
    def features(self) -> FakeResult:
        """Return the result itself, of which the live filter only uses the stamp."""
        return self


class FakeFilter:
    """Returns the stamps of the image and of the detections it was given, instead of features."""

    camera = None

    def __init__(self, *, needs_detections: bool = True, senses_motion: bool = False) -> None:
        self.needs_detections, self._senses_motion = needs_detections, senses_motion
        self.counters: dict[str, int] = {}
        self.motion_ns: list[int] = []
        self.num_resets = 0

    def reset(self) -> None:
        self.num_resets += 1

    def detect_corners(self, frame: RgbdFrame) -> FakeCorners:
        return FakeCorners(frame)

    def select_and_describe(
        self, corners: DetectedCorners, detections: Detections | None, *, for_picture: bool
    ) -> FakeResult:
        assert not for_picture
        return FakeResult(corners.frame.stamp_ns, detections)

    def detect_motion(self, corners: DetectedCorners) -> None:
        self.motion_ns.append(corners.frame.stamp_ns)

    def is_motion_known(self, stamp_ns: int) -> bool:
        return not self._senses_motion or stamp_ns in self.motion_ns

    def reevaluate(
        self, features: Features, depth_m: Float32Array, detections: Detections | None
    ) -> FakeResult:
        del depth_m
        return FakeResult(features.stamp_ns, detections)


class FakeOutputs:
    """Records what is published; nobody subscribes to debug images or masks."""

    wants_picture, wants_masks = False, False

    def __init__(self) -> None:
        self.published: list[tuple[Row, bool]] = []  # with whether the verdict was provisional
        self.final: list[Row] = []

    def publish(
        self, frame: RgbdFrame, result: FilterResult, header: object, *, provisional: bool
    ) -> None:
        del frame, header
        self.published.append((cast('FakeResult', result).row, provisional))

    def publish_final(self, final: FinalVerdict, header: object, size_px: tuple[int, int]) -> None:
        del header, size_px
        self.final.append(cast('FakeResult', final).row)

    def publish_masks(
        self,
        final: FinalVerdict,
        depth_m: Float32Array,
        header: object,
        camera: CameraModel | None,
    ) -> None:
        raise AssertionError(final, depth_m, header, camera)


class FakeDiagnostics:
    """Stores counters, and the text of each current problem."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.problems: dict[str, str] = {}
        self.notes: list[str] = []

    def count(self, name: str, number: int = 1) -> None:
        self.counts[name] = self.counts.get(name, 0) + number

    def set_count(self, name: str, number: int) -> None:
        self.counts[name] = number

    def report(self, error: HoidError, what: str) -> None:
        del error
        self.count(what)

    def note(self, text: str, what: str) -> None:
        self.notes.append(text)
        self.count(what)

    def set_problem(self, name: str, text: str, *, severe: bool) -> None:
        assert severe
        self.problems[name] = text

    def clear_problem(self, name: str) -> None:
        self.problems.pop(name, None)


class Bench:
    """A live filter with fakes around it, and a clock that the test sets."""

    def __init__(self, feature_filter: FakeFilter | None = None, **values: float | str) -> None:
        self.now_s = 0.0
        self.filter = feature_filter or FakeFilter()
        self.outputs, self.diagnostics = FakeOutputs(), FakeDiagnostics()
        self.published, self.final = self.outputs.published, self.outputs.final
        self.counts, self.problems = self.diagnostics.counts, self.diagnostics.problems
        self.num_idle_requests = 0
        self.live = LiveFilter(
            DetectionInputConfig().updated(values),
            cast('FeatureFilter', self.filter),
            self.outputs,
            self.diagnostics,
            self._request_idle,
            lambda: self.now_s,
        )

    def _request_idle(self) -> None:
        self.num_idle_requests += 1

    @property
    def num_without_detections(self) -> int:
        return self.counts.get('images without detections', 0)

    def add_image(self, stamp_ns: int, now_s: float) -> list[tuple[Row, bool]]:
        """Add an image, let the node become idle, and return what was published at once."""
        self.now_s = now_s
        before = len(self.published)
        self.live.add_image(None, frame_at(stamp_ns))
        self.live.on_idle()
        self.live.on_idle()
        return self.published[before:]

    def detect(self, stamp_ns: int, now_s: float) -> list[Row]:
        """Add empty detections and return the final verdicts that they cause."""
        self.now_s = now_s
        before = len(self.final)
        self.live.add_detections(Detections.none(stamp_ns))
        return self.final[before:]

    def poll(self, now_s: float) -> list[Row]:
        """Return the final verdicts that are published because the wait is over."""
        self.now_s = now_s
        before = len(self.final)
        self.live.poll()
        return self.final[before:]


def started(**values: Any) -> Bench:
    """Return a bench whose detector has answered the image of stamp 1."""
    bench = Bench(**values)
    bench.detect(1, 0.0)
    assert bench.add_image(1, 0.0) == [((1, 1), False)]
    return bench


def frame_at(stamp_ns: int) -> RgbdFrame:
    image_bgr, depth_m = np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1), np.float32)
    return RgbdFrame(stamp_ns, image_bgr, depth_m)
