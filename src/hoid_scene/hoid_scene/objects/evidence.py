"""The evidence for one object: its class, its existence, and its presence at its place.

A look is an image in which the object may be visible. A sighting is a look that detected it.
"""

from __future__ import annotations

import math

import numpy as np

from hoid_common.values import NS_PER_S, FloatArray

# Numbers without a source were not tuned. An object is certain (`is_sufficient`) only after three
# sightings over 0.4 s, or five sightings.
_MIN_SIGHTINGS, _MIN_AGE_NS, _AT_ONCE = 3, NS_PER_S * 2 // 5, 5
# Chosen: an object is certain if all of its detections are wrong with at most this probability.
# The score of an independent detection, up to _MAX_SCORE, is taken as the probability that it is
# right. Most wrong objects on real clips have a larger probability of being wrong.
_MAX_WRONG, _MAX_SCORE = 0.15, 0.95
_MIN_SEEN_RATIO = 0.4  # least ratio of detections to looks that show its surface
# An object with at least this number of sightings is kept, but marked as gone, if it was not
# detected in this number of successive looks at its place and in more than half of all looks.
_MANY_SIGHTINGS, _MISSING_LOOKS = 6, 4
# Effect of a look on the probability that the object is still there: gain towards 1 of a sighting,
# relative loss by a missed detection and by a look that shows the place empty.
_SEEN_GAIN, _MISSED_LOSS, _THROUGH_LOSS = 0.3, 0.03, 0.35
_MAX_CLASSES = 8  # chosen: classes of an object that are kept
# Chosen: directions to an object that differ less are one view (17 cm to the side at 1 m).
_SAME_VIEW = np.cos(np.deg2rad(10.0))
# Chosen: an object that was detected within this time is probably still in view; a detection with
# at most this weight changes little.
_IN_VIEW_NS, _LEAST_WEIGHT = NS_PER_S // 2, 1 / 16
# Chosen: detections that count fully from a direction; largest number of directions.
_PER_VIEW, _MAX_VIEWS = 3, 64

_CONFUSABLE_CLASSES = (
    frozenset({'chair', 'couch', 'bench', 'bed'}),
    frozenset({'dining table', 'bed', 'bench', 'couch'}),
    frozenset({'cup', 'bottle', 'vase', 'bowl', 'wine glass', 'potted plant'}),
    frozenset({'tv', 'laptop', 'microwave', 'oven', 'refrigerator'}),
    frozenset({'book', 'cell phone', 'remote', 'laptop', 'keyboard'}),
    frozenset({'suitcase', 'backpack', 'handbag'}),
    frozenset({'teddy bear', 'sports ball'}),
)


class Views:
    """The directions from which an object was detected, at least 10 degrees apart.

    Detections from one direction are not independent: a detector repeats its errors on images that
    are alike.
    """

    def __init__(self) -> None:
        self.directions: FloatArray = np.empty((0, 3))  # (V, 3) unit vectors, object frame
        self.counts: list[int] = []  # number of detections from each direction
        self.last_weight = 1.0  # weight of the last detection

    def __len__(self) -> int:
        return len(self.counts)

    def add(self, direction: FloatArray, count: int = 1) -> float:
        """Count detections from a direction (3,); return the weight of the last detection.

        The first three detections from a direction weigh 1; the weight then halves each time.
        """
        cosine = self.directions @ direction
        if len(cosine) == 0 or (cosine.max() < _SAME_VIEW and len(cosine) < _MAX_VIEWS):
            self.directions = np.concatenate([self.directions, direction[None]])
            self.counts.append(0)
            nearest = len(self.counts) - 1
        else:
            nearest = int(np.argmax(cosine))
        self.counts[nearest] += count
        self.last_weight = 0.5 ** max(0, self.counts[nearest] - _PER_VIEW)
        return self.last_weight


class Evidence:
    """Counts and scores of the looks at an object.

    Attributes:
        scores: Sums of the scores of its detections, by class.
        weight: Minus the logarithm of the probability that all of them are wrong, each weighted by
            the independence of its view (`Views`).
        num_sightings: Number of images in which it was detected with its surface.
        num_visible: Number of images that showed its surface.
        num_through: Number of successive looks that showed its place empty.
        num_absent: Number of successive looks at its place, empty or not, without a detection.
        first_ns: Stamp of the first sighting.
        last_ns: Stamp of the last sighting.
        probability: Probability that it is still at its place.
    """

    def __init__(self, stamp_ns: int) -> None:
        self.scores: dict[str, float] = {}
        self.views, self.weight = Views(), 0.0
        self.num_sightings = self.num_visible = self.num_through = self.num_absent = 0
        self.first_ns = self.last_ns = stamp_ns
        self.probability = 0.5

    @property
    def class_names(self) -> list[str]:
        """Return the class with the largest sum of scores, and those that resemble it."""
        names = sorted(self.scores, key=self.scores.__getitem__, reverse=True)
        return [name for name in names if is_confusable(name, names[0])]

    @property
    def is_sufficient(self) -> bool:
        """Return whether the object was detected often, long and certainly enough."""
        is_at_once = self.num_sightings >= _AT_ONCE
        is_old = is_at_once or self.last_ns - self.first_ns >= _MIN_AGE_NS
        is_often = self.num_sightings >= _MIN_SIGHTINGS and self.weight >= -math.log(_MAX_WRONG)
        return is_old and is_often and self.seen_ratio >= _MIN_SEEN_RATIO

    def is_open(self, stamp_ns: int) -> bool:
        """Return whether the next images may decide whether the object exists.

        It must have been detected lately, and not often from the same direction.
        """
        is_in_view = 0 <= stamp_ns - self.last_ns < _IN_VIEW_NS
        return is_in_view and not self.is_sufficient and self.views.last_weight > _LEAST_WEIGHT

    @property
    def seen_ratio(self) -> float:
        return self.num_sightings / max(self.num_visible, 1)

    @property
    def is_brief(self) -> bool:
        """Return whether the object has too few sightings to be new, handled or missing."""
        return self.num_sightings < _MANY_SIGHTINGS

    @property
    def is_missing(self) -> bool:
        """Return whether many looks that showed a surface at the place had no detection.

        The place of a flat object that was taken does not look empty.
        """
        is_absent = self.num_absent >= _MISSING_LOOKS and self.seen_ratio <= _MIN_SEEN_RATIO
        return is_absent and not self.is_brief

    def add(self, class_name: str, score: float, direction: FloatArray) -> None:
        """Count a detection with the unit vector (3,) from the camera, object frame."""
        self.num_sightings += 1
        self.num_visible += 1
        self.weight -= self.views.add(direction) * math.log(1 - min(score, _MAX_SCORE))
        self._add_scores({class_name: score})

    def _add_scores(self, scores: dict[str, float]) -> None:
        for name, score in scores.items():
            self.scores[name] = self.scores.get(name, 0.0) + score
        while len(self.scores) > _MAX_CLASSES:
            del self.scores[min(self.scores, key=self.scores.__getitem__)]

    def note_seen(self, stamp_ns: int) -> None:
        self.last_ns = stamp_ns
        self.num_through = self.num_absent = 0
        self.probability += _SEEN_GAIN * (1 - self.probability)

    def note_missed(self) -> bool:
        """Count a look with a surface at its place, but no detection; return `is_missing`."""
        self.num_through = 0
        self.num_absent += 1
        self.probability *= 1 - _MISSED_LOSS
        is_missing = self.is_missing
        self.num_visible += not is_missing
        return is_missing

    def note_seen_through(self) -> None:
        self.num_through += 1
        self.num_absent += 1
        self.probability *= 1 - _THROUGH_LOSS

    def merge(self, other: Evidence, R_this_other: FloatArray) -> None:
        """Add other evidence for the same object, given the rotation (3, 3) of its frame."""
        self._add_scores(other.scores)
        self.num_sightings += other.num_sightings
        self.num_visible += other.num_visible
        self.weight += other.weight
        for direction, count in zip(other.views.directions, other.views.counts, strict=True):
            self.views.add(R_this_other @ direction, count)
        self.first_ns = min(self.first_ns, other.first_ns)
        self.last_ns = max(self.last_ns, other.last_ns)
        self.probability = max(self.probability, other.probability)


def is_confusable(first: str, second: str) -> bool:
    """Return whether two classes are the same, or detectors confuse them."""
    return first == second or any({first, second} <= group for group in _CONFUSABLE_CLASSES)
