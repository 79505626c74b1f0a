"""The interfaces between the live filter and its node: published results, and diagnostics."""

from __future__ import annotations

from typing import Any, Protocol

from hoid_common.values import CameraModel, FilterResult, Float32Array, RgbdFrame
from hoid_filter.feature_filter import FinalVerdict


class LiveOutputs(Protocol):
    """Publishes the results for an image. `header` is the header of its color image message."""

    @property
    def wants_picture(self) -> bool:
        """Return whether anybody subscribes to the debug image."""

    @property
    def wants_masks(self) -> bool:
        """Return whether anybody subscribes to the masked images or point clouds."""

    def publish(
        self, frame: RgbdFrame, result: FilterResult, header: Any, *, provisional: bool
    ) -> None:
        """Publish features and objects, and the debug image if anybody subscribes to it.

        If `provisional`, `publish_final` follows, unless the image is dropped before.
        """

    def publish_final(self, final: FinalVerdict, header: Any, size_px: tuple[int, int]) -> None:
        """Publish the final verdict on an image that was published provisionally."""

    def publish_masks(
        self, final: FinalVerdict, depth_m: Float32Array, header: Any, camera: CameraModel | None
    ) -> None:
        """Publish the masked images and the point clouds that have subscribers.

        Without `camera`, or if its size is not that of the image, no point clouds are published.
        """


class LiveDiagnostics(Protocol):
    """Counters and problems that the node shows on /diagnostics."""

    def count(self, name: str, number: int = 1) -> None:
        """Add `number` to the counter `name`."""

    def set_count(self, name: str, number: int) -> None:
        """Set the counter `name` to `number`."""

    def note(self, text: str, what: str) -> None:
        """Log an event that is no error, and count it under the name `what`."""

    def set_problem(self, name: str, text: str, *, severe: bool) -> None:
        """Show a problem until `clear_problem` is called with its name."""

    def clear_problem(self, name: str) -> None:
        """Stop showing a problem."""
