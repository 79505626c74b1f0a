"""The interfaces between the live filter and its node: published results, and diagnostics."""

from __future__ import annotations

from typing import Any, Protocol

from hoid_common.values import CameraModel, FilterResult, Float32Array, RgbdFrame
from hoid_filter.feature_filter import FinalVerdict


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
    """Counters and problems that the node shows on /diagnostics."""

    def count(self, name: str, number: int = 1) -> None: ...

    def set_count(self, name: str, number: int) -> None: ...

    def note(self, text: str, what: str) -> None: ...

    def set_problem(self, name: str, text: str, *, severe: bool) -> None: ...

    def clear_problem(self, name: str) -> None: ...
