"""Which detections an image is judged with: at once, and once more when its own are there."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

from hoid_common.config import Config, param
from hoid_common.errors import MessageError
from hoid_common.sync import RESTART_NS
from hoid_common.values import NS_PER_S, Detections

UNFILTERED, STOP = 'unfiltered', 'stop'
_QUEUE_LENGTH = 30
_LEAD_S = 1.0  # much more than detections come before their image, which waits for its depth

Item = TypeVar('Item')


@dataclass(frozen=True)
class GateConfig(Config):
    """How images and detections come together."""

    wait_s: float = param(
        0.5,
        'Longest time that mapping waits for what an image shows by its own detections; tracking '
        'waits only before the first answer of the detector (s).',
        minimum=0.0, maximum=10.0, read_only=False, expert=True,
    )  # fmt: skip
    as_vision_msgs: bool = param(
        default=False,
        description="Takes another detector's boxes: vision_msgs/Detection2DArray with the names "
        'of classes as class_id, on detections_2d, in place of detections.',
        expert=True,
    )
    timeout_s: float = param(
        2.0, 'Without detections for this long, the detector counts as lost (s).',
        minimum=0.1, maximum=3600.0, read_only=False, expert=True,
    )  # fmt: skip
    on_loss: str = param(
        UNFILTERED,
        'Whether to go on unfiltered or to stop publishing when the detector is lost. Choose stop '
        'where a map with people in it is worse than no odometry.',
        choices=(UNFILTERED, STOP),
        read_only=False,
    )


class Known(NamedTuple):
    """What is known of an image as it comes."""

    detections: Detections | None  # of its stamp or older, each given out once; None: no new ones
    is_final: bool  # nothing that is to come says more of it


class Answered(NamedTuple, Generic[Item]):
    """An image that is judged for good now."""

    item: Item
    detections: Detections | None  # of its stamp or the next; None: there are none to wait for


class _Waiting(NamedTuple, Generic[Item]):
    stamp_ns: int
    item: Item
    since_s: float


class DetectionGate(Generic[Item]):
    """Gives each image the detections that are there, and remembers it until its own are.

    A detector that skips images (newest wins) tells so by its next answer; one that is lost is not
    waited for. Images are answered in order. Times are of a steady clock, in seconds.
    """

    def __init__(self, config: GateConfig) -> None:
        self.config = config
        self.num_unanswered = 0  # images that had no detections of their own in the end
        self._waiting: deque[_Waiting[Item]] = deque()
        self._detections = _queue()  # that no image has been given
        self._has_answered = False  # the detector, since the stream began
        self._asked_s: float | None = None  # first image since the last answer
        self._image_s = 0.0  # last image
        self._newest_ns: int | None = None  # its stamp

    @property
    def silent_s(self) -> float:
        """Return over how long a time images got no answer."""
        return 0.0 if self._asked_s is None else self._image_s - self._asked_s

    @property
    def is_lost(self) -> bool:
        """Return whether the detector counts as lost."""
        return self.silent_s > self.config.timeout_s

    @property
    def is_blind(self) -> bool:
        """Return whether the detector may be there but has said nothing so far to predict from."""
        return not self._has_answered and not self.is_lost

    @property
    def is_shut(self) -> bool:
        """Return whether nothing is to be published without a detector."""
        return self.config.on_loss == STOP and self.is_lost

    def restart_if_back(self, stamp_ns: int) -> bool:
        """Forget the past when an image's stamp says that time started anew; return whether so.

        To be called before the image is added. What was detected in it may have come already, and
        is kept.
        """
        if self._newest_ns is None or self._newest_ns - stamp_ns < RESTART_NS:
            return False
        self._waiting.clear()
        self._detections = _queue(
            found for found in self._detections if found.stamp_ns <= stamp_ns
        )
        self._has_answered = bool(self._detections)
        return True

    def add_image(self, stamp_ns: int, now_s: float) -> Known:
        """Take note of an image and return what is known of it."""
        self._image_s, self._newest_ns = now_s, stamp_ns
        if self._asked_s is None:
            self._asked_s = now_s
        is_passed = any(found.stamp_ns >= stamp_ns for found in self._detections)
        known = self._take(stamp_ns)
        is_own = known is not None and known.stamp_ns == stamp_ns
        is_final = is_passed or self.is_lost
        self.num_unanswered += is_final and not is_own
        return Known(known, is_final)

    def remember(self, stamp_ns: int, item: Item, now_s: float) -> None:
        """Have an image that was just added, and is not final, answered later."""
        self._waiting.append(_Waiting(stamp_ns, item, now_s))

    def add_detections(self, detections: Detections, now_s: float) -> list[Answered[Item]]:
        """Take detections and return what they answer.

        Raises:
            MessageError: They are of a later image than can have been taken by now.
        """
        newest_ns = self._newest_ns
        if newest_ns is not None:
            lead_s = (detections.stamp_ns - newest_ns) / NS_PER_S
            if lead_s > now_s - self._image_s + _LEAD_S:
                raise MessageError(f'detections are {lead_s:.1f} s ahead of the newest image')
        self._asked_s, self._has_answered = None, True
        answered = []
        while self._waiting and self._waiting[0].stamp_ns <= detections.stamp_ns:
            waiting = self._waiting.popleft()
            self.num_unanswered += waiting.stamp_ns != detections.stamp_ns
            answered.append(Answered(waiting.item, detections))
        if not answered or newest_ns is None or detections.stamp_ns > newest_ns:
            self._detections.append(detections)
        return answered

    def poll(self, now_s: float) -> list[Answered[Item]]:
        """Return the images that are no longer to wait."""
        answered: list[Answered[Item]] = []
        while self._waiting and self._is_over(self._waiting[0], now_s):
            answered.append(Answered(self._waiting.popleft().item, None))
        self.num_unanswered += len(answered)
        return answered

    def _is_over(self, waiting: _Waiting[Item], now_s: float) -> bool:
        return (
            now_s - waiting.since_s >= self.config.wait_s
            or self.is_lost
            or len(self._waiting) > _QUEUE_LENGTH
        )

    def _take(self, stamp_ns: int) -> Detections | None:
        """Return the newest detections up to a stamp, and forget the older ones."""
        past = [found for found in self._detections if found.stamp_ns <= stamp_ns]
        self._detections = _queue(found for found in self._detections if found.stamp_ns > stamp_ns)
        return max(past, key=lambda found: found.stamp_ns, default=None)


def _queue(found: Iterable[Detections] = ()) -> deque[Detections]:
    return deque(found, maxlen=_QUEUE_LENGTH)
