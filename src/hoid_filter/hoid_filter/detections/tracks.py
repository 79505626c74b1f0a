"""Multi-object tracking of boxes in the image, through missed detections."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from hoid_common.values import PERSON, S_PER_NS, BoolArray, Detections, FloatArray
from hoid_filter.config import FilterConfig
from hoid_filter.detections.prediction import match_greedily
from hoid_filter.detections.sanitize import areas_px2, clip_boxes
from hoid_native import intersections_over_union

_MIN_IOU = 0.2  # chosen: least overlap of a predicted box and a detection of the same object
# Chosen: least overlap of a predicted box and a doubtful detection, which may be false and must
# therefore fit the track closely.
_MIN_IOU_UNSURE = 0.5
# Least overlap of a predicted box and a detection of another class. Detectors alternate between
# classes for one object, with nearly the same box; less overlap means another object.
_MIN_IOU_OTHER_CLASS = 0.5  # decision 011
# Chosen: subtracted from the overlap with a detection of another class, so that at equal overlap
# the same class is preferred.
_OTHER_CLASS_PENALTY = 0.15
_VELOCITY_GAIN = 0.3  # chosen: beta of an alpha-beta filter with alpha = 1; box edges are noisy
_MIN_VISIBLE_RATIO = 0.15  # chosen: an object has left the image if less of its box is inside
# Chosen: a track with fewer detections than `_ESTABLISHED_HITS` may be false. If the detector
# misses it, it is kept for only `_NEW_TRACK_COAST_RATIO` of `coast_s`, and predicted only if it is
# a person.
_ESTABLISHED_HITS = 3
_NEW_TRACK_COAST_RATIO = 0.3


@dataclass
class BoxTrack:
    """A tracked person or object: its box, its image velocity, and whether a person handles it."""

    track_id: int
    class_name: str  # class of the last detection
    score: float  # score of the last detection
    box_xyxy_px: list[float]  # box of the last detection
    seen_ns: int  # stamp of the last detection
    # Number of detections that confirm a track of doubtful detections only; 0 = one of its
    # detections was trusted.
    hits_to_confirm: int = 0
    hits: int = 1  # number of detections
    is_missed: bool = False  # True: the newest detections do not contain this track
    # Velocity of the box's center. Predicted boxes keep their size, because detected edges jump
    # (decision 011).
    velocity_px_s: list[float] = field(default_factory=lambda: [0.0, 0.0])
    torso_m: float = float('nan')  # depth of a person's torso; NaN = unknown
    is_handled: bool = False  # whether a person handles the object
    # Observed time since a person last handled the object; inf = never.
    untouched_s: float = float('inf')

    @property
    def is_person(self) -> bool:
        return self.class_name == PERSON

    @property
    def is_established(self) -> bool:
        return self.hits >= _ESTABLISHED_HITS

    @property
    def is_confirmed(self) -> bool:
        """Return whether one detection was trusted, or enough doubtful ones have come in a row."""
        return self.hits >= self.hits_to_confirm

    def observe(
        self, box: list[float], expected: list[float], class_name: str, score: float, stamp_ns: int
    ) -> None:
        """Update the track with a new detection; `expected` is the box predicted for its stamp."""
        step_s = (stamp_ns - self.seen_ns) * S_PER_NS
        if step_s > 0:
            error_px = [new - old for new, old in zip(box, expected, strict=True)]
            center_error_px = (error_px[0] + error_px[2]) / 2, (error_px[1] + error_px[3]) / 2
            pairs = zip(self.velocity_px_s, center_error_px, strict=True)
            self.velocity_px_s = [v + _VELOCITY_GAIN * px / step_s for v, px in pairs]
            self.untouched_s += step_s
        self.box_xyxy_px, self.seen_ns = box, stamp_ns
        self.class_name, self.score, self.hits = class_name, score, self.hits + 1
        self.is_missed = False


class BoxTracker:
    """Associates detections with tracks by overlap, and predicts tracks that were not detected."""

    def __init__(self, config: FilterConfig) -> None:
        self._plus, self._silent_s = config.plus, config.prediction_limit_s
        self._tracks: list[BoxTrack] = []
        self._next_id = 0
        self._newest_ns: int | None = None  # stamp of the last detections

    def observe(self, detections: Detections, is_unsure: BoolArray) -> None:
        """Update the tracks with N newer detections, and start tracks for unmatched ones.

        `is_unsure` (N,) flags doubtful detections. A track that has only these is confirmed after
        `hits_to_confirm` detections in a row.
        """
        stamp_ns = detections.stamp_ns
        if self._newest_ns is not None and stamp_ns <= self._newest_ns:
            return
        self._newest_ns = stamp_ns
        boxes = detections.boxes_xyxy_px.astype(np.float64)
        expected = boxes_at(self._tracks, stamp_ns)
        min_iou = np.where(is_unsure, _MIN_IOU_UNSURE, _MIN_IOU)
        similarity = self._similarity(expected, detections, boxes)
        i, k = match_greedily(np.where(similarity >= min_iou, similarity, 0.0), _MIN_IOU)
        names, scores = detections.class_names, detections.scores.tolist()
        box_rows, expected_rows = boxes.tolist(), expected.tolist()
        for track in self._tracks:
            track.is_missed = True
        for at_track, at in zip(i.tolist(), k.tolist(), strict=True):
            track = self._tracks[at_track]
            track.observe(box_rows[at], expected_rows[at_track], names[at], scores[at], stamp_ns)
            track.hits_to_confirm *= bool(is_unsure[at])
        for at in sorted(set(range(len(names))) - set(k.tolist())):
            needed = self._plus.doubt_detections * bool(is_unsure[at])
            self._tracks.append(
                BoxTrack(self._next_id, names[at], scores[at], box_rows[at], stamp_ns, needed)
            )
            self._next_id += 1
        # A track of doubtful detections only ends at its first miss, even if it is confirmed.
        self._tracks = [t for t in self._tracks if not (t.is_missed and t.hits_to_confirm)]

    def _similarity(
        self, expected: FloatArray, detections: Detections, boxes: FloatArray
    ) -> FloatArray:
        """Return the overlaps (T, N) of predicted and detected boxes; 0 if they cannot match."""
        if not self._tracks or not len(boxes):
            return np.zeros((len(self._tracks), len(boxes)))
        # Classes are compared as numbers, which is faster than names.
        number = defaultdict(count(1).__next__, {PERSON: 0})
        tracked = np.array([number[track.class_name] for track in self._tracks])
        detected = np.array([number[name] for name in detections.class_names])
        is_other_class = tracked[:, None] != detected
        is_same_kind = (tracked == 0)[:, None] == (detected == 0)
        iou = intersections_over_union(expected, boxes)
        may_match = is_same_kind & ~(is_other_class & (iou < _MIN_IOU_OTHER_CLASS))
        return np.where(may_match, iou - _OTHER_CLASS_PENALTY * is_other_class, 0.0)

    def drop_missed(self) -> None:
        """Delete the tracks that were not detected in the newest image with detections."""
        self._tracks = [track for track in self._tracks if not track.is_missed]

    def advance(
        self, stamp_ns: int, width_px: int, height_px: int
    ) -> tuple[tuple[BoxTrack, ...], FloatArray]:
        """Predict all tracks; delete those that were missed for too long or have left the image.

        Returns the T active tracks, those in the newest detections first, and their boxes (T, 4),
        clipped to the image. A missed object is active only if it was detected three times and was
        handled within `rest_s`.
        """
        boxes = boxes_at(self._tracks, stamp_ns)
        inside = clip_boxes(boxes, width_px, height_px)
        is_visible = areas_px2(inside) > _MIN_VISIBLE_RATIO * areas_px2(boxes)
        kept = [
            n
            for n, track in enumerate(self._tracks)
            if is_visible[n] and _unseen_s(track, stamp_ns) <= self._limit_s(track)
        ]
        active = [n for n in kept if self._is_active(self._tracks[n])]
        active.sort(key=lambda n: self._tracks[n].is_missed)
        tracks = tuple(self._tracks[n] for n in active)
        self._tracks = [self._tracks[n] for n in kept]
        return tracks, inside[active]

    def _limit_s(self, track: BoxTrack) -> float:
        if not track.is_missed:
            return self._silent_s
        ratio = 1.0 if track.is_established else _NEW_TRACK_COAST_RATIO
        return ratio * self._plus.coast_s

    def _is_active(self, track: BoxTrack) -> bool:
        was_handled = track.is_established and track.untouched_s < self._plus.rest_s
        return not track.is_missed or track.is_person or was_handled


def _unseen_s(track: BoxTrack, stamp_ns: int) -> float:
    return (stamp_ns - track.seen_ns) * S_PER_NS


def boxes_at(tracks: list[BoxTrack], stamp_ns: int) -> FloatArray:
    """Return the boxes (T, 4) at a stamp by constant velocity, unclipped, at least 1 px wide."""
    seen = np.array([track.box_xyxy_px for track in tracks]).reshape(-1, 4)
    velocity_px_s = np.array([track.velocity_px_s for track in tracks]).reshape(-1, 2)
    since_s = np.array([stamp_ns - track.seen_ns for track in tracks]) * S_PER_NS
    boxes: FloatArray = seen + np.tile(velocity_px_s * since_s[:, None], 2)
    boxes[:, 2:] = np.maximum(boxes[:, 2:], boxes[:, :2] + 1.0)
    return boxes
