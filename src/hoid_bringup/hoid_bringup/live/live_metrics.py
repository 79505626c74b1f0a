"""Timing and counts of a live run by image, collected from messages in any order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from hoid_bringup.run.summary import FilterCounts

_MS_PER_NS = 1e-6
_FRAME_STAGES = frozenset({'extract', 'filter', 'track'})


@dataclass
class LiveMetrics:
    """Timing and counts of images; the keys are stamps of images in ns."""

    # By stamp: wall-clock times (ns) at which an image was published and its odometry arrived.
    published_ns: dict[int, int] = field(default_factory=dict)
    odometry_ns: dict[int, int] = field(default_factory=dict)
    # Stamps of the images that SLAM has processed.
    processed: set[int] = field(default_factory=set)
    # By stamp: number of detected features, and number of removed ones.
    num_features: dict[int, tuple[int, int]] = field(default_factory=dict)
    # By stamp: number of dynamic objects.
    num_dynamic: dict[int, int] = field(default_factory=dict)
    _stage_ms: dict[int, dict[str, float]] = field(default_factory=dict)

    @property
    def num_processed(self) -> int:
        return len(self.processed)

    def record_stages(self, stamp_ns: int, stage_ms: Mapping[str, float]) -> None:
        """Add the durations (ms) of stages for an image."""
        self._stage_ms.setdefault(stamp_ns, {}).update(stage_ms)

    def latency_ms(self) -> list[float]:
        """Return the times (ms) from publishing an image to receiving its odometry, by stamp.

        Images are left out if one of the times is unknown.
        """
        return [
            (at_ns - self.published_ns[stamp_ns]) * _MS_PER_NS
            for stamp_ns, at_ns in sorted(self.odometry_ns.items())
            if stamp_ns in self.published_ns
        ]

    def stage_ms(self) -> dict[str, list[float]]:
        """Return the durations (ms) by stage, one for each image in which the stage was timed.

        `frame` is the sum of `extract`, `filter` and `track`, for images that have all three.
        """
        out: dict[str, list[float]] = {}
        for _, stages in sorted(self._stage_ms.items()):
            if stages.keys() >= _FRAME_STAGES:
                out.setdefault('frame', []).append(sum(stages[name] for name in _FRAME_STAGES))
            for name, spent_ms in stages.items():
                out.setdefault(name, []).append(spent_ms)
        return out

    def filter_counts(self) -> FilterCounts:
        return FilterCounts(
            sum(detected for detected, _ in self.num_features.values()),
            sum(removed for _, removed in self.num_features.values()),
            sum(self.num_dynamic.values()),
        )
