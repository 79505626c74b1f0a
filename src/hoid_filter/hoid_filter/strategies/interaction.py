"""The rule by which `hoid+` decides which objects people handle, with hysteresis and memory."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from hoid_common.values import BoolArray, FloatArray, ObjectState
from hoid_filter.config import FilterConfig
from hoid_filter.detections.tracks import BoxTrack
from hoid_native import overlap_ratios


@dataclass(frozen=True, eq=False)
class Interactions:
    """How each of N tracked objects interacts with people."""

    reasons: tuple[ObjectState, ...]  # N reasons why a track is static or dynamic
    # (N,) ratio of the object's box that the box of a person covers: the person who handles it, or
    # else the one who covers most of it. 0 for people, and if there are no people.
    overlap_ratios: FloatArray
    # (N,) absolute depth difference to the same person; NaN = unknown, or no such person.
    depth_gaps_m: FloatArray


@dataclass(frozen=True, eq=False)
class TrackSnapshot:
    """N tracked people and objects at the stamp of an image."""

    stamp_ns: int
    tracks: tuple[BoxTrack, ...]
    boxes_xyxy_px: FloatArray  # (N, 4)
    depths_m: FloatArray  # (N,) of a person's torso or an object's middle; NaN = unknown

    @property
    def is_person(self) -> BoolArray:
        """Return (N,) whether each track is a person, and not possibly a false detection."""
        return _flags(track.is_person and track.is_confirmed for track in self.tracks)


def classify_interactions(snapshot: TrackSnapshot, config: FilterConfig) -> Interactions:
    """Return how each track interacts with people, and store in it whether it is handled.

    A confirmed person handles an object of a class that may be handled if the person's box covers
    more than `min_interaction_area` of the object's box, and the object is at most `reach_m`
    nearer to the camera than the torso and at most `depth_limit_m` farther (unknown depth: near).
    With `remember`, `release_share` of that area suffices for an object that was handled before
    (hysteresis).
    """
    plus = config.plus
    tracks = snapshot.tracks
    num = len(tracks)
    is_person = snapshot.is_person
    can_be_handled = _flags(config.may_be_handled(track.class_name) for track in tracks)
    overlap = overlap_ratios(snapshot.boxes_xyxy_px, snapshot.boxes_xyxy_px)
    behind_m = snapshot.depths_m[:, None] - snapshot.depths_m
    gap_m = np.abs(behind_m)
    min_overlap = np.full(num, config.min_interaction_area)
    if plus.remember:
        min_overlap[_flags(track.is_handled for track in tracks)] *= plus.release_share
    # The comparisons are negated, so that an unknown depth (NaN) counts as near.
    is_near = ~((behind_m > config.depth_limit_m) | (behind_m < -plus.reach_m))
    touches = (overlap > min_overlap[:, None]) & is_near & can_be_handled[:, None]
    is_handled = np.asarray((touches & is_person).any(axis=1))
    score = np.where(is_person & ~np.eye(num, dtype=np.bool_), overlap + touches, -1.0)
    partner = score.argmax(axis=1) if num else np.empty(0, np.int64)
    has_no_partner = (score.max(axis=1, initial=-1.0) < 0) | is_person
    index = np.arange(num)
    return Interactions(
        _reasons(snapshot, is_handled, config),
        np.where(has_no_partner, 0.0, overlap[index, partner]),
        np.where(has_no_partner, np.nan, gap_m[index, partner]),
    )


def _reasons(
    snapshot: TrackSnapshot, is_handled: BoolArray, config: FilterConfig
) -> tuple[ObjectState, ...]:
    """Store in each track whether it is handled, and return the states of all tracks."""
    reasons = []
    for track, handled in zip(snapshot.tracks, is_handled.tolist(), strict=True):
        track.is_handled = handled
        if handled:
            track.untouched_s = 0.0
        is_remembered = config.plus.remember and track.untouched_s < config.plus.rest_s
        is_dynamic = (track.is_person and track.is_confirmed) or handled or is_remembered
        reasons.append(_reason(track, snapshot.stamp_ns, is_dynamic, handled))
    return tuple(reasons)


def _reason(track: BoxTrack, stamp_ns: int, is_dynamic: bool, is_handled: bool) -> ObjectState:
    if not is_dynamic:
        return ObjectState.AT_REST
    if track.seen_ns != stamp_ns:
        return ObjectState.PREDICTED
    if track.is_person:
        return ObjectState.PERSON
    return ObjectState.HANDLED if is_handled else ObjectState.REMEMBERED


def _flags(values: Iterable[bool]) -> BoolArray:
    return np.array(list(values), np.bool_)
