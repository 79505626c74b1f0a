"""Detection of missing images and of repeated images in a stream.

If the camera needs a long exposure in the dark, a driver that is set to 30 Hz sends a color image
twice, the second time with a new stamp and a new depth image. If such copies were tracked, the
camera would seem to stop at each of them and to move twice as fast after it.
"""

from __future__ import annotations

import logging
from collections import deque
from enum import Enum
from statistics import fmean

import numpy as np

from hoid_common.sync import MAX_COPY_AGE_NS
from hoid_common.values import NS_PER_S, Features, IntArray

_logger = logging.getLogger(__name__)

# Chosen, not tuned: number of intervals whose mean is the period of the stream: one second at 30
# Hz.
_WINDOW = 31  # number of intervals whose mean is the period of the stream: one second at 30 Hz
_MIN_INTERVALS = 5  # the period is known from this number of intervals on
# After this many successive gaps with the same number of missing images, the stream has a lower
# rate, such as that of a camera in the dark.
_NEW_RATE = 15
_PAUSE_NS = NS_PER_S  # a longer gap is a pause of camera or bag, in which no image is lost
# Chosen: an image is a copy if more than this ratio of its features have exactly the positions of
# features of the original. In other images, the noise of the camera moves all features by
# fractions of a pixel. In a copy, some features differ, because the filter may have removed
# others.
_MIN_SHARE = 0.5
_NOTE = (
    'a color image was received twice under two stamps: the camera takes fewer images than its '
    'driver sends, for example in the dark; the poses of copies are predicted'
)


class DroppedFrameCounter:
    """Counts images that are missing according to the rate of the stream.

    Stamps do not show whether a missing image was dropped or never taken. If a stream skips the
    same number of images `_NEW_RATE` times in a row, it is taken to have a lower rate.
    """

    def __init__(self) -> None:
        self.num_dropped = 0
        self._last_ns: int | None = None
        self._intervals_ns: deque[float] = deque(maxlen=_WINDOW)
        self._num_missing = 0  # number of images missing before the last one
        self._num_equal = 0  # number of successive intervals with this many missing images

    def add(self, stamp_ns: int) -> None:
        """Add the stamp of the next image, and count the images missing before it.

        The period of the stream is known after five intervals. It is measured again after a stamp
        that is not later than the last one, or after a gap of more than a second.
        """
        last_ns, self._last_ns = self._last_ns, stamp_ns
        if last_ns is None or not 0 < stamp_ns - last_ns <= _PAUSE_NS:
            self._restart()
            return
        interval_ns = float(stamp_ns - last_ns)
        if len(self._intervals_ns) >= _MIN_INTERVALS:
            num_missing = max(0, round(interval_ns / fmean(self._intervals_ns)) - 1)
            self.num_dropped += num_missing
            self._num_equal = self._num_equal + 1 if num_missing == self._num_missing else 1
            self._num_missing = num_missing
            if num_missing and self._num_equal == _NEW_RATE:
                self._restart()
                return
            interval_ns /= num_missing + 1  # so that gaps do not increase the mean interval
        self._intervals_ns.append(interval_ns)

    def _restart(self) -> None:
        self._intervals_ns.clear()
        self._num_missing = self._num_equal = 0


class Repetition(Enum):
    """Which parts of an image repeat the latest original, the latest image that was not a copy."""

    NOTHING = 'nothing'
    COLOR = 'color'  # the color image is repeated, the depth image is new
    ALL = 'all'  # color and depth are repeated


class RepeatedImages:
    """Recognizes copies, most of whose features are at exactly the same pixels as before."""

    def __init__(self) -> None:
        self.num_repeated = 0  # number of color images that were repeated with a new depth image
        self._original: Features | None = None

    @property
    def original_ns(self) -> int | None:
        """Return the stamp (ns) of the latest original; None at the start."""
        return None if self._original is None else self._original.stamp_ns

    def add(self, features: Features) -> Repetition:
        """Return which parts of the next image repeat the latest original."""
        original = self._original
        if original is None or not 0 <= features.stamp_ns - original.stamp_ns <= MAX_COPY_AGE_NS:
            self._original = features
            return Repetition.NOTHING
        is_same = np.isin(_pixels(features), _pixels(original))
        if np.count_nonzero(is_same) <= _MIN_SHARE * len(features):
            self._original = features
            return Repetition.NOTHING
        if np.isin(_readings(features)[is_same], _readings(original)).all():
            return Repetition.ALL
        if not self.num_repeated:
            _logger.warning(_NOTE)
        self.num_repeated += 1
        return Repetition.COLOR


def _pixels(features: Features) -> IntArray:
    """Return numbers (N,) that are equal if and only if two positions are equal in all bits."""
    uv_px = np.ascontiguousarray(features.uv_px, np.float32)
    return np.asarray(uv_px.view(np.int64)[:, 0])


def _readings(features: Features) -> IntArray:
    return np.asarray(np.ascontiguousarray(features.depth_m, np.float32).view(np.int32))
