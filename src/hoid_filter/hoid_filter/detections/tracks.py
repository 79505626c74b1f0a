"""People and objects followed over time in the image, through missed detections."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import count

import numpy as np

from hoid_common.values import PERSON, S_PER_NS, BoolArray, Detections, FloatArray
from hoid_filter.detections.overlap import areas_px2, clip_boxes
from hoid_filter.detections.prediction import match_greedily
from hoid_native import intersections_over_union

_MIN_IOU = 0.2  # of a predicted box and the detection of the same thing
_MIN_IOU_DOUBTFUL = 0.5
# Detectors waver between classes of objects, with much the same box; another box is another thing.
_MIN_IOU_OTHER_CLASS = 0.5
_OTHER_CLASS_PENALTY = 0.15
_VELOCITY_GAIN = 0.3  # of the alpha-beta filter: detected boxes jump by some pixels
_MIN_VISIBLE = 0.15  # share of a box inside the image, else it has left
_KNOWN_HITS = 3  # a thing seen less often ...
_UNKNOWN_COAST_SHARE = 0.3  # ... is believed for less long when it is missed


@dataclass
class BoxTrack:
    """One thing: its box, its motion in the image, and what is known of it."""

    track_id: int
    class_name: str
    score: float
    box_xyxy_px: list[float]  # as last detected
    seen_ns: int  # when last detected
    hits_needed: int = 0  # to be believed; 0 = it was seen for sure
    hits: int = 1
    missed: bool = False  # among the last detections
    # Of the box as a whole: its edges jump, and so would the size that is predicted from them.
    velocity_px_s: list[float] = field(default_factory=lambda: [0.0, 0.0])
    torso_m: float = float('nan')  # depth of a person's torso
    handled: bool = False
    untouched_s: float = float('inf')  # time seen since it was last handled

    @property
    def is_person(self) -> bool:
        """Return whether it moves by itself."""
        return self.class_name == PERSON

    @property
    def is_known(self) -> bool:
        """Return whether it was seen often enough to be more than a whim of the detector."""
        return self.hits >= _KNOWN_HITS

    @property
    def doubtful(self) -> bool:
        """Return whether it is not to be believed yet."""
        return self.hits < self.hits_needed

    def observe(
        self, box: list[float], expected: list[float], class_name: str, score: float, stamp_ns: int
    ) -> None:
        """Take in a detection of a thing whose box was expected elsewhere."""
        step_s = (stamp_ns - self.seen_ns) * S_PER_NS
        if step_s > 0:
            off_px = [new - old for new, old in zip(box, expected, strict=True)]
            moved_px = (off_px[0] + off_px[2]) / 2, (off_px[1] + off_px[3]) / 2
            pairs = zip(self.velocity_px_s, moved_px, strict=True)
            self.velocity_px_s = [v + _VELOCITY_GAIN * px / step_s for v, px in pairs]
            self.untouched_s += step_s
        self.box_xyxy_px, self.seen_ns = box, stamp_ns
        self.class_name, self.score, self.hits = class_name, score, self.hits + 1
        self.missed = False


@dataclass(frozen=True)
class Patience:
    """What the tracker believes without, or against, a detection."""

    late_s: float  # how long boxes are predicted while the detector says nothing
    coast_s: float  # how long something known that is missed is predicted
    rest_s: float  # how long an object is suspect after it was handled
    doubt_hits: int  # detections that make a doubtful thing believed


class BoxTracker:
    """Associates detections with tracks by overlap and predicts the tracks that are missed."""

    def __init__(self, patience: Patience) -> None:
        self._patience = patience
        self._tracks: list[BoxTrack] = []
        self._next_id = 0
        self._heard_ns: int | None = None  # stamp of the last detections

    def observe(self, detections: Detections, doubtful: BoolArray) -> None:
        """Update the tracks with what was detected at a stamp; what is not newer is ignored.

        Args:
            doubtful: (N,), True for detections to be believed only where they go on a track.
        """
        stamp_ns = detections.stamp_ns
        if self._heard_ns is not None and stamp_ns <= self._heard_ns:
            return
        self._heard_ns = stamp_ns
        boxes = detections.boxes_xyxy_px.astype(np.float64)
        expected = boxes_at(self._tracks, stamp_ns)
        least = np.where(doubtful, _MIN_IOU_DOUBTFUL, _MIN_IOU)
        likeness = self._likeness(expected, detections, boxes)
        i, k = match_greedily(np.where(likeness >= least, likeness, 0.0), _MIN_IOU)
        names, scores = detections.class_names, detections.scores.tolist()
        box_rows, expected_rows = boxes.tolist(), expected.tolist()
        for track in self._tracks:
            track.missed = True
        for at_track, at in zip(i.tolist(), k.tolist(), strict=True):
            track = self._tracks[at_track]
            track.observe(box_rows[at], expected_rows[at_track], names[at], scores[at], stamp_ns)
            track.hits_needed *= bool(doubtful[at])
        for at in sorted(set(range(len(names))) - set(k.tolist())):
            needed = self._patience.doubt_hits * bool(doubtful[at])
            self._tracks.append(
                BoxTrack(self._next_id, names[at], scores[at], box_rows[at], stamp_ns, needed)
            )
            self._next_id += 1
        # What was never sure has to be seen again and again without a gap, also once believed.
        self._tracks = [t for t in self._tracks if not (t.missed and t.hits_needed)]

    def _likeness(
        self, expected: FloatArray, detections: Detections, boxes: FloatArray
    ) -> FloatArray:
        """Return the (T, N) overlaps of predicted and detected boxes of the same kind."""
        if not self._tracks or not len(boxes):
            return np.zeros((len(self._tracks), len(boxes)))
        number = defaultdict(count(1).__next__, {PERSON: 0})  # of a class: quick to compare
        known = np.array([number[track.class_name] for track in self._tracks])
        seen = np.array([number[name] for name in detections.class_names])
        other_class = known[:, None] != seen
        same_kind = (known == 0)[:, None] == (seen == 0)
        iou = intersections_over_union(expected, boxes)
        alike = same_kind & ~(other_class & (iou < _MIN_IOU_OTHER_CLASS))
        return np.where(alike, iou - _OTHER_CLASS_PENALTY * other_class, 0.0)

    def advance(
        self, stamp_ns: int, width_px: int, height_px: int
    ) -> tuple[tuple[BoxTrack, ...], FloatArray]:
        """Forget what was not seen for too long or left the image.

        Returns:
            The tracks to be believed at the stamp, those of the last detections first, and their
            (T, 4) boxes, clipped. One that is missed and not believed is remembered all the same,
            so that it is known when it is seen again.
        """
        boxes = boxes_at(self._tracks, stamp_ns)
        inside = clip_boxes(boxes, width_px, height_px)
        visible = areas_px2(inside) > _MIN_VISIBLE * areas_px2(boxes)
        remembered = [
            n
            for n, track in enumerate(self._tracks)
            if visible[n] and _unseen_s(track, stamp_ns) <= self._limit_s(track)
        ]
        believed = [n for n in remembered if self._is_believed(self._tracks[n])]
        believed.sort(key=lambda n: self._tracks[n].missed)
        tracks = tuple(self._tracks[n] for n in believed)
        self._tracks = [self._tracks[n] for n in remembered]
        return tracks, inside[believed]

    def _limit_s(self, track: BoxTrack) -> float:
        if not track.missed:
            return self._patience.late_s
        share = 1.0 if track.is_known else _UNKNOWN_COAST_SHARE
        return share * self._patience.coast_s

    def _is_believed(self, track: BoxTrack) -> bool:
        """Return whether it was not missed, or moved when last seen."""
        suspect = track.is_known and track.untouched_s < self._patience.rest_s
        return not track.missed or track.is_person or suspect


def _unseen_s(track: BoxTrack, stamp_ns: int) -> float:
    return (stamp_ns - track.seen_ns) * S_PER_NS


def boxes_at(tracks: list[BoxTrack], stamp_ns: int) -> FloatArray:
    """Return the (T, 4) boxes expected at a stamp: where they were seen, moved on since."""
    seen = np.array([track.box_xyxy_px for track in tracks]).reshape(-1, 4)
    velocity_px_s = np.array([track.velocity_px_s for track in tracks]).reshape(-1, 2)
    since_s = np.array([stamp_ns - track.seen_ns for track in tracks]) * S_PER_NS
    boxes: FloatArray = seen + np.tile(velocity_px_s * since_s[:, None], 2)
    boxes[:, 2:] = np.maximum(boxes[:, 2:], boxes[:, :2] + 1.0)
    return boxes
