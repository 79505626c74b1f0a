"""Verdicts on features that come apart from them: later as a rule, sometimes before."""

from __future__ import annotations

from collections import OrderedDict
from typing import TypeVar

from hoid_common.errors import MessageError
from hoid_common.values import Features, FeatureVerdicts

T = TypeVar('T')

_LIMIT = 60  # keyframes that may still be judged again, and verdicts that wait for their image


class LateVerdicts:
    """Knows which frames became keyframes lately, and what was said of frames to come."""

    def __init__(self) -> None:
        self._keyframes: OrderedDict[int, int] = OrderedDict()  # number of features by stamp
        self._early: OrderedDict[int, FeatureVerdicts] = OrderedDict()  # by stamp
        self._newest_ns = self._num_newest = 0  # stamp and features of the newest image

    def filtered(self, features: Features) -> Features:
        """Return an image's features without those that are known to move by now."""
        early = self._early.pop(features.stamp_ns, None)
        if early is not None and len(early.is_dynamic) == len(features):
            features = features.select(~early.is_dynamic)
        self._newest_ns, self._num_newest = features.stamp_ns, len(features)
        return features

    def note_keyframe(self) -> None:
        """Expect a verdict on the newest image, which has become a keyframe."""
        _put(self._keyframes, self._newest_ns, self._num_newest)

    def is_due(self, verdicts: FeatureVerdicts) -> bool:
        """Return whether a verdict changes a keyframe; one on an image to come is kept for it.

        Raises:
            MessageError: It is of another number of features than the keyframe has.
        """
        stamp_ns, num = verdicts.stamp_ns, len(verdicts.is_dynamic)
        if stamp_ns > self._newest_ns:
            _put(self._early, stamp_ns, verdicts)
        expected = self._keyframes.pop(stamp_ns, None)
        if expected is None or not verdicts.is_dynamic.any():
            return False
        if num != expected:
            raise MessageError(f'feature_verdicts are of {num} features, the image has {expected}')
        return True


def _put(queue: OrderedDict[int, T], stamp_ns: int, value: T) -> None:
    queue[stamp_ns] = value
    if len(queue) > _LIMIT:
        queue.popitem(last=False)
