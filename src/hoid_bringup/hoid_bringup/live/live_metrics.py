"""Numbers of a live run, put together by image stamp as messages come in any order."""

from __future__ import annotations

from collections.abc import Mapping

from hoid_bringup.run.summary import FilterCounts

_MS_PER_NS = 1e-6
_FRAME_STAGES = frozenset({'extract', 'filter', 'track'})


class LiveMetrics:
    """Latencies, times per stage and counts."""

    def __init__(self) -> None:
        self._sent_ns: dict[int, int] = {}
        self._answered_ns: dict[int, int] = {}
        self._stage_ms: dict[int, dict[str, float]] = {}
        self._processed: set[int] = set()
        self._features: dict[int, tuple[int, int]] = {}
        self._dynamic: dict[int, int] = {}

    @property
    def num_processed(self) -> int:
        """Return the number of images that the SLAM node has dealt with."""
        return len(self._processed)

    def note_sent(self, stamp_ns: int, at_ns: int) -> None:
        """Note when an image was published (wall time)."""
        self._sent_ns[stamp_ns] = at_ns

    def note_odometry(self, stamp_ns: int, at_ns: int) -> None:
        """Note when the odometry of an image arrived (wall time)."""
        self._answered_ns[stamp_ns] = at_ns

    def note_processed(self, stamp_ns: int) -> None:
        """Note that the SLAM node has dealt with an image."""
        self._processed.add(stamp_ns)

    def note_stages(self, stamp_ns: int, stage_ms: Mapping[str, float]) -> None:
        """Note what stages took of an image."""
        self._stage_ms.setdefault(stamp_ns, {}).update(stage_ms)

    def note_features(self, stamp_ns: int, num_detected: int, num_removed: int) -> None:
        """Note how many features an image had, and how many of them the filter removed."""
        self._features[stamp_ns] = num_detected, num_removed

    def note_objects(self, stamp_ns: int, num_dynamic: int) -> None:
        """Note how many objects of an image are dynamic."""
        self._dynamic[stamp_ns] = num_dynamic

    def latency_ms(self) -> list[float]:
        """Return the times from an image's publication to its odometry, in order of stamps."""
        return [
            (at_ns - self._sent_ns[stamp_ns]) * _MS_PER_NS
            for stamp_ns, at_ns in sorted(self._answered_ns.items())
            if stamp_ns in self._sent_ns
        ]

    def stage_ms(self) -> dict[str, list[float]]:
        """Return each stage's times; `frame` is extraction, filter and tracking of one image."""
        out: dict[str, list[float]] = {}
        for _, stages in sorted(self._stage_ms.items()):
            if stages.keys() >= _FRAME_STAGES:
                out.setdefault('frame', []).append(sum(stages[name] for name in _FRAME_STAGES))
            for name, spent_ms in stages.items():
                out.setdefault(name, []).append(spent_ms)
        return out

    def filter_counts(self) -> FilterCounts:
        """Return what the filter did, summed over all images."""
        return FilterCounts(
            sum(detected for detected, _ in self._features.values()),
            sum(removed for _, removed in self._features.values()),
            sum(self._dynamic.values()),
        )
