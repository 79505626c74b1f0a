"""The memory of one object: its colors, its best picture and its history."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.io.images import encode_jpeg
from hoid_common.io.records import Record, column
from hoid_common.values import ByteArray, DynamicObject, FloatArray, IntArray
from hoid_scene.memory.colors import COLORS, color_counts, color_names
from hoid_scene.memory.history import EventKind, History, ObjectEvent, PresentState

MAX_JPEG_BYTES, MAX_SIDE_PX = 20_000, 320  # chosen: bounds of a picture
_QUALITIES = (85, 60, 35)  # chosen: of the JPEG; the first one with which it is small enough
_MARGIN = 0.1  # chosen: a picture shows this ratio of the box's size beyond each side
# Chosen: a picture is replaced by one that is better by this factor, so that few are taken.
_BETTER = 1.15
_CUT = 0.5  # chosen: factor of the rank of a picture that the border of the image cuts
_MAX_COUNT = 1_000_000  # chosen: colors are counted until there are so many pixels


class Look(NamedTuple):
    """The detection of a known object in an image."""

    memory: ObjectMemory
    detection: DynamicObject
    pixels: IntArray  # (M,) flat indices of the strided pixels that show the object
    is_cut: bool  # whether its box reaches the border of the image


@dataclass(frozen=True, eq=False)
class MemoryState(Record):
    """The memory of one object in a file."""

    stamp_ns: Annotated[IntArray, column('i8', 'events')]
    kind: Annotated[NDArray[np.uint8], column('u1', 'events')]  # values of `EventKind`
    person_id: Annotated[IntArray, column('i8', 'events')]
    distance_m: Annotated[FloatArray, column('f8', 'events')]
    color_px: Annotated[IntArray, column('i8', len(COLORS))]  # number of pixels by color
    picture_ns: Annotated[IntArray, column('i8', 1)]  # stamp of the picture
    picture_rank: Annotated[FloatArray, column('f8', 1)]  # how well it shows the object
    jpeg: Annotated[ByteArray, column('u1', 'bytes')]  # empty: there is no picture


NO_MEMORIES: Mapping[int, MemoryState] = MappingProxyType({})


class ObjectMemory:
    """The colors, the best picture and the history of one object.

    Attributes:
        jpeg: The image of the object that shows it best, as JPEG of at most 20 kB; b'': none.
        picture_ns: Stamp of this image.
    """

    def __init__(self) -> None:
        self.history = History()
        self.jpeg, self.picture_ns = b'', 0
        self._rank = 0.0  # rank of the picture
        self._color_px: IntArray = np.zeros(len(COLORS), np.int64)
        self._names: tuple[str, ...] | None = ()  # None: out of date
        self._state: MemoryState | None = None  # None: out of date

    @property
    def color_names(self) -> tuple[str, ...]:
        """Return the object's colors, the most frequent one first; () if none was measured."""
        if self._names is None:
            self._names = color_names(self._color_px)
        return self._names

    def wants_picture(self, rank: float) -> bool:
        return rank > _BETTER * self._rank

    def count_colors(self, pixels_bgr: ByteArray) -> None:
        """Count the colors of pixels (N, 3) of the object."""
        if self._color_px.sum() < _MAX_COUNT:
            self._color_px = self._color_px + color_counts(pixels_bgr)
            self._names = self._state = None

    def put_picture(self, crop_bgr: ByteArray, rank: float, stamp_ns: int) -> None:
        """Keep a crop (H, W, 3) as the object's picture; `rank`: how well it shows the object."""
        self.jpeg, self._rank, self.picture_ns = _small_jpeg(crop_bgr), rank, stamp_ns
        self._state = None

    def note(self, present: PresentState, stamp_ns: int) -> None:
        """Add to the history the events that the object's state after an image shows."""
        if self.history.note(present, stamp_ns):
            self._state = None

    def absorb(self, other: ObjectMemory) -> None:
        """Add the memory of another object that has proved to be the same object."""
        self.history.add(other.history.events)
        self.move_to(other)

    def move_to(self, other: ObjectMemory) -> None:
        """Add colors and picture of the object that was created when this one was put down."""
        self._color_px = self._color_px + other._color_px
        self._names = self._state = None
        if other._rank > self._rank:
            self.jpeg, self._rank, self.picture_ns = other.jpeg, other._rank, other.picture_ns

    def state(self) -> MemoryState:
        """Return the memory for a file; the same record as long as nothing has changed."""
        if self._state is None:
            events = self.history.events
            self._state = MemoryState.of(
                {
                    'stamp_ns': np.array([event.stamp_ns for event in events], np.int64),
                    'kind': np.array([event.kind.value for event in events], np.uint8),
                    'person_id': np.array([event.person_id for event in events], np.int64),
                    'distance_m': np.array([event.distance_m for event in events], np.float64),
                    'color_px': self._color_px,
                    'picture_ns': np.array([self.picture_ns]),
                    'picture_rank': np.array([self._rank]),
                    'jpeg': np.frombuffer(self.jpeg, np.uint8),
                }
            )
        return self._state

    @classmethod
    def of(cls, state: MemoryState) -> ObjectMemory:
        """Return the memory from a file that has been checked."""
        memory = cls()
        columns = (state.stamp_ns, state.kind, state.person_id, state.distance_m)
        memory.history.events = tuple(
            ObjectEvent(stamp_ns, EventKind(kind), person_id, distance_m)
            for stamp_ns, kind, person_id, distance_m in zip(
                *(column.tolist() for column in columns), strict=True
            )
        )
        memory._color_px = state.color_px.astype(np.int64)
        memory.jpeg, memory._names = state.jpeg.tobytes(), None
        memory._rank, memory.picture_ns = float(state.picture_rank[0]), int(state.picture_ns[0])
        return memory


def remember(
    looks: Sequence[Look],
    people: Sequence[DynamicObject],
    image: Callable[[], ByteArray],
    stride: int,
    stamp_ns: int,
) -> None:
    """Add colors and pictures from an image to the memories of the objects that it shows.

    The image (H, W, 3) is asked for only if it shows an object better than its picture does.
    `stride` is the step in px between strided pixels.
    """
    at_rest = [look for look in looks if not look.detection.is_dynamic]
    ranks = [_rank(look, people) for look in at_rest]
    is_better = [
        look.memory.wants_picture(rank) for look, rank in zip(at_rest, ranks, strict=True)
    ]
    if not any(is_better):
        return
    image_bgr = image()
    strided_bgr = image_bgr[::stride, ::stride].reshape(-1, 3)
    for look, rank, is_wanted in zip(at_rest, ranks, is_better, strict=True):
        look.memory.count_colors(strided_bgr[look.pixels])
        if is_wanted:
            crop_bgr = _crop(image_bgr, look.detection.box_xyxy_px)
            look.memory.put_picture(crop_bgr, rank, stamp_ns)


def _rank(look: Look, people: Sequence[DynamicObject]) -> float:
    """Return how well an image shows an object.

    It is the product of the detection's score, the square root of the number of pixels, and the
    ratio of the box that no person's box covers; half of this if the box is cut.
    """
    covered = max((_shared(look.detection, person) for person in people), default=0.0)
    size = float(np.sqrt(len(look.pixels))) * (_CUT if look.is_cut else 1.0)
    return look.detection.score * size * (1 - covered)


def _shared(item: DynamicObject, person: DynamicObject) -> float:
    box, other = np.array(item.box_xyxy_px), np.array(person.box_xyxy_px)
    low, high = np.maximum(box[:2], other[:2]), np.minimum(box[2:], other[2:])
    return float(np.maximum(high - low, 0).prod() / max((box[2:] - box[:2]).prod(), 1.0))


def _crop(image_bgr: ByteArray, box_xyxy_px: tuple[float, ...]) -> ByteArray:
    """Return the part (h, w, 3) of an image in a box, with a margin, cut at the border."""
    height, width = image_bgr.shape[:2]
    box = np.array(box_xyxy_px)
    margin = _MARGIN * (box[2:] - box[:2])
    left, top = np.clip(np.floor(box[:2] - margin), 0, (width - 1, height - 1)).astype(int)
    right, bottom = np.clip(np.ceil(box[2:] + margin), (left + 1, top + 1), (width, height))
    return image_bgr[top : int(bottom), left : int(right)]


def _small_jpeg(image_bgr: ByteArray) -> bytes:
    """Return the JPEG of an image (H, W, 3), reduced to at most 320 px and 20 kB."""
    scale = MAX_SIDE_PX / max(image_bgr.shape[:2])
    while True:
        small = image_bgr
        if scale < 1:
            size = [max(1, int(scale * side)) for side in image_bgr.shape[1::-1]]
            small = np.asarray(cv2.resize(image_bgr, size, interpolation=cv2.INTER_AREA))
        for quality in _QUALITIES:
            jpeg = encode_jpeg(small, quality)
            if len(jpeg) <= MAX_JPEG_BYTES:
                return jpeg
        scale = min(scale, 1.0) / 2
