"""When an image is filtered, and with which detections: wait for its own, or take the newest."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

from hoid_common.config import Config, param
from hoid_common.errors import MessageError
from hoid_common.sync import RESTART_NS
from hoid_common.values import NS_PER_S, Detections

EXACT, LATEST = 'exact', 'latest'
UNFILTERED, STOP = 'unfiltered', 'stop'
_QUEUE_LENGTH = 30
_LEAD_S = 1.0  # much more than detections come before their image, which waits for its depth

Item = TypeVar('Item')


@dataclass(frozen=True)
class GateConfig(Config):
    """How images and detections come together."""

    mode: str = param(
        EXACT,
        'Whether an image waits for its own detections (exact) or never waits and takes predicted '
        'boxes (latest). Choose latest when the detector is slower than the camera.',
        choices=(EXACT, LATEST),
        read_only=False,
    )
    wait_s: float = param(
        0.15, 'Longest time that an image waits for its detections in the mode exact (s).',
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


class Ready(NamedTuple, Generic[Item]):
    """An image to be filtered now."""

    item: Item
    detections: Detections | None  # of its stamp or older, each given out once; None: no new ones


class _Waiting(NamedTuple, Generic[Item]):
    stamp_ns: int
    item: Item
    since_s: float


class DetectionGate(Generic[Item]):
    """Holds images back until their detections are there, or are not to be waited for.

    Images go through in order. A detector that skips images (newest wins) tells so by its next
    answer; one that is lost is not waited for. Times are of a steady clock, in seconds.
    """

    def __init__(self, config: GateConfig) -> None:
        self.config = config
        self.num_unanswered = 0  # images that went through without detections of their own
        self._images: deque[_Waiting[Item]] = deque()
        self._detections = _queue()
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

    def restart_if_back(self, stamp_ns: int) -> bool:
        """Forget the past when an image's stamp says that time started anew; return whether so.

        To be called before the image is added. What was detected in it may have come already, and
        is kept.
        """
        if self._newest_ns is None or self._newest_ns - stamp_ns < RESTART_NS:
            return False
        self._images.clear()
        self._detections = _queue(
            found for found in self._detections if found.stamp_ns <= stamp_ns
        )
        return True

    def add_image(self, stamp_ns: int, item: Item, now_s: float) -> list[Ready[Item]]:
        """Take an image and return what is ready."""
        self._image_s, self._newest_ns = now_s, stamp_ns
        if self._asked_s is None:
            self._asked_s = now_s
        self._images.append(_Waiting(stamp_ns, item, now_s))
        return self.poll(now_s)

    def add_detections(self, detections: Detections, now_s: float) -> list[Ready[Item]]:
        """Take detections and return what is ready.

        Raises:
            MessageError: They are of a later image than can have been taken by now.
        """
        if self._newest_ns is not None:
            lead_s = (detections.stamp_ns - self._newest_ns) / NS_PER_S
            if lead_s > now_s - self._image_s + _LEAD_S:
                raise MessageError(f'detections are {lead_s:.1f} s ahead of the newest image')
        self._asked_s = None
        self._detections.append(detections)
        return self.poll(now_s)

    def poll(self, now_s: float) -> list[Ready[Item]]:
        """Return the images that are ready by now."""
        ready = []
        while self._images and self._may_go(self._images[0], now_s):
            waiting = self._images.popleft()
            if self.config.on_loss == STOP and self.is_lost:
                continue
            detections = self._take(waiting.stamp_ns)
            self.num_unanswered += detections is None or detections.stamp_ns < waiting.stamp_ns
            ready.append(Ready(waiting.item, detections))
        return ready

    def _may_go(self, waiting: _Waiting[Item], now_s: float) -> bool:
        answered = bool(self._detections) and self._detections[-1].stamp_ns >= waiting.stamp_ns
        return (
            answered
            or self.config.mode == LATEST
            or now_s - waiting.since_s >= self.config.wait_s
            or self.is_lost
            or len(self._images) > _QUEUE_LENGTH
        )

    def _take(self, stamp_ns: int) -> Detections | None:
        """Return the newest detections up to a stamp, and forget the older ones."""
        past = [found for found in self._detections if found.stamp_ns <= stamp_ns]
        self._detections = _queue(found for found in self._detections if found.stamp_ns > stamp_ns)
        return max(past, key=lambda found: found.stamp_ns, default=None)


def _queue(found: Iterable[Detections] = ()) -> deque[Detections]:
    return deque(found, maxlen=_QUEUE_LENGTH)
