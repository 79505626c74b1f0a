"""Assignment of feature verdicts to images: most arrive after the features, some before."""

from __future__ import annotations

from collections import OrderedDict
from typing import TypeVar

from hoid_common.errors import MessageError
from hoid_common.values import Features, FeatureVerdicts

T = TypeVar('T')

# Chosen: two seconds of images at 30 Hz, while a detector is late by 20 to 500 ms (decision 031).
_MAX_WAITING = 60  # number of keyframes without a verdict, and of verdicts without an image


class LateVerdicts:
    """Stores the latest keyframes without a verdict, and verdicts that came before their image."""

    def __init__(self) -> None:
        self._keyframes: OrderedDict[int, int] = OrderedDict()  # number of features by stamp
        self._early: OrderedDict[int, FeatureVerdicts] = OrderedDict()  # verdicts by stamp
        self._newest_ns = self._num_newest = 0  # stamp and number of features of the newest image

    def filtered(self, features: Features) -> Features:
        """Return the features of the next image that no early verdict calls dynamic."""
        early = self._early.pop(features.stamp_ns, None)
        if early is not None and len(early.is_dynamic) == len(features):
            features = features.select(~early.is_dynamic)
        self._newest_ns, self._num_newest = features.stamp_ns, len(features)
        return features

    def expect_verdict(self) -> None:
        """Store that the newest image became a keyframe, for which a verdict may follow."""
        _put(self._keyframes, self._newest_ns, self._num_newest)

    def changes_keyframe(self, verdicts: FeatureVerdicts) -> bool:
        """Return whether a keyframe's first verdicts have come, and some features are dynamic.

        Verdicts on an image that has not arrived yet are stored for `filtered`. MessageError if
        the keyframe has another number of features.
        """
        stamp_ns, num = verdicts.stamp_ns, len(verdicts.is_dynamic)
        if stamp_ns > self._newest_ns:
            _put(self._early, stamp_ns, verdicts)
        expected = self._keyframes.pop(stamp_ns, None)
        if expected is None or not verdicts.is_dynamic.any():
            return False
        if num != expected:
            raise MessageError(
                f'feature_verdicts are of {num} features, but the image has {expected}: only one '
                'filter may publish them'
            )
        return True


def _put(queue: OrderedDict[int, T], stamp_ns: int, value: T) -> None:
    queue[stamp_ns] = value
    if len(queue) > _MAX_WAITING:
        queue.popitem(last=False)
