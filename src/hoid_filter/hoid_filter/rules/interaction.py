"""Which objects people handle, with hysteresis, memory and chains."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from hoid_common.values import BoolArray, FloatArray, Reason
from hoid_filter.config import FilterConfig
from hoid_filter.detections.tracks import BoxTrack
from hoid_native import overlap_ratios


@dataclass(frozen=True, eq=False)
class Interactions:
    """How N tracks stand to people."""

    reasons: tuple[Reason, ...]  # N
    overlap_ratios: FloatArray  # (N,), with the person (or handled object) who covers most
    depth_gaps_m: FloatArray  # (N,), to the same; NaN = unknown


@dataclass(frozen=True, eq=False)
class TrackSnapshot:
    """N tracks at the stamp of an image."""

    stamp_ns: int
    tracks: tuple[BoxTrack, ...]
    boxes_xyxy_px: FloatArray  # (N, 4)
    depths_m: FloatArray  # (N,), of the torso for people; NaN = unknown

    @property
    def is_person(self) -> BoolArray:
        """Return the (N,) flags of people who are believed."""
        return _flags(track.is_person and not track.doubtful for track in self.tracks)


def judge_interactions(snapshot: TrackSnapshot, config: FilterConfig) -> Interactions:
    """Return the verdict on each track, and note on the tracks what to remember.

    An object is handled when a person covers more than `min_interaction_area` of it, and goes on
    being handled down to `release_area`; a person farther than `reach_m` in depth does not count.
    """
    plus = config.plus
    tracks = snapshot.tracks
    num = len(tracks)
    is_person = snapshot.is_person
    candidate = _flags(config.may_be_handled(track.class_name) for track in tracks)
    overlap = overlap_ratios(snapshot.boxes_xyxy_px, snapshot.boxes_xyxy_px)
    behind_m = snapshot.depths_m[:, None] - snapshot.depths_m
    gap_m = np.abs(behind_m)
    limit = np.full(num, config.min_interaction_area)
    if plus.remember:
        limit[_flags(track.handled for track in tracks)] = plus.release_area
    near = ~((behind_m > config.depth_limit_m) | (behind_m < -plus.reach_m))
    touches = (overlap > limit[:, None]) & near & candidate[:, None]
    handled = np.asarray((touches & is_person).any(axis=1))
    movers = is_person
    if plus.chains:
        close = touches & ~(gap_m > config.depth_limit_m)
        handled = _spread(handled, close)
        movers = is_person | handled
    best = np.where(movers & ~np.eye(num, dtype=np.bool_), overlap + touches, -1.0)
    partner = best.argmax(axis=1) if num else np.empty(0, np.int64)
    index = np.arange(num)
    alone = best.max(axis=1, initial=-1.0) < 0
    return Interactions(
        _reasons(snapshot, handled, config),
        np.where(alone | is_person, 0.0, overlap[index, partner]),
        np.where(alone | is_person, np.nan, gap_m[index, partner]),
    )


def _spread(handled: BoolArray, close: BoolArray) -> BoolArray:
    """Return the (N,) objects that touch a handled one, directly or over others."""
    while True:
        more = handled | (close & handled).any(axis=1)
        if np.array_equal(more, handled):
            return handled
        handled = more


def _reasons(
    snapshot: TrackSnapshot, handled: BoolArray, config: FilterConfig
) -> tuple[Reason, ...]:
    reasons = []
    for track, touched in zip(snapshot.tracks, handled.tolist(), strict=True):
        track.handled = touched
        if touched:
            track.untouched_s = 0.0
        suspect = config.plus.remember and track.untouched_s < config.plus.rest_s
        dynamic = (track.is_person and not track.doubtful) or touched or suspect
        reasons.append(_reason(track, snapshot.stamp_ns, dynamic, touched))
    return tuple(reasons)


def _reason(track: BoxTrack, stamp_ns: int, dynamic: bool, touched: bool) -> Reason:
    if not dynamic:
        return Reason.STATIC
    if track.seen_ns != stamp_ns:
        return Reason.PREDICTED
    if track.is_person:
        return Reason.PERSON
    return Reason.HANDLED if touched else Reason.REMEMBERED


def _flags(values: Iterable[bool]) -> BoolArray:
    return np.array(list(values), np.bool_)
