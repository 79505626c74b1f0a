"""One object of the object map: its surface, the evidence for it, and its history."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray, ObjectState
from hoid_scene.grid.floor import Floor
from hoid_scene.level.upright_box import Level
from hoid_scene.memory.history import ObjectEvent, PresentState
from hoid_scene.memory.object_memory import ObjectMemory
from hoid_scene.objects.evidence import Evidence
from hoid_scene.objects.object_surface import ObjectSurface
from hoid_scene.objects.segmentation import Segment
from hoid_scene.place import Place

# Furniture, whose legs are rarely seen: its box is extended down to the floor.
_STANDING = frozenset({'chair', 'couch', 'dining table', 'bed', 'bench'})
# Smallest and largest diagonal [m] of the measured box of a certain object, by class. Chosen from
# products on sale, with half of the object hidden; other classes have any size.
_DIAGONALS_M = {
    'tv': (0.38, 1.65), 'laptop': (0.2, 0.6), 'keyboard': (0.2, 0.8), 'mouse': (0.05, 0.25),
    'cell phone': (0.08, 0.3), 'remote': (0.08, 0.4), 'book': (0.1, 0.7), 'cup': (0.05, 0.35),
    'wine glass': (0.08, 0.4), 'bottle': (0.08, 0.7), 'bowl': (0.08, 0.6), 'vase': (0.08, 1.2),
    'clock': (0.08, 1.0), 'scissors': (0.08, 0.4), 'sports ball': (0.05, 0.7),
    'teddy bear': (0.1, 1.6), 'backpack': (0.2, 1.2), 'handbag': (0.15, 1.0),
    'suitcase': (0.25, 1.6), 'potted plant': (0.1, 3.0), 'chair': (0.25, 2.0),
    'couch': (0.5, 4.0), 'bed': (0.7, 4.0), 'dining table': (0.4, 4.5), 'toilet': (0.3, 1.4),
    'sink': (0.25, 1.6), 'microwave': (0.3, 1.2), 'oven': (0.4, 1.8), 'refrigerator': (0.7, 2.8),
}  # fmt: skip
# Largest height [m] of the measured box, by class. An open laptop has at most 0.27 m, to which
# depth noise adds; most screens are higher.
_HEIGHTS_M = {'laptop': 0.32}
# Chosen: an object at rest is listed if it is still there with at least this probability.
_LIKELY = 0.5


@dataclass(frozen=True, eq=False)
class MapObject:
    """An object of the map as it is published."""

    object_id: int
    class_name: str  # the class with the largest sum of scores
    class_scores: tuple[tuple[str, float], ...]  # sums of the scores of each class, largest first
    state: ObjectState
    T_map_object: FloatArray  # (4, 4) pose of the center of the box, whose z axis points up
    size_m: FloatArray  # (3,) extent along the axes of the box
    num_sightings: int  # number of images in which it was detected at rest
    first_ns: int  # stamp of the first sighting
    last_ns: int  # stamp of the last sighting
    probability: float  # probability that it is still there, in [0, 1]
    holder_id: int = -1  # track of the person who handles or moved it; -1: unknown
    # (3,) center of its box at the previous place, in the map frame; None: it was not moved.
    moved_from_map_m: FloatArray | None = None
    moved_ns: int = 0  # stamp of its last sighting at the previous place; 0: not moved
    is_new: bool = False  # whether a loaded map did not contain it, although it is seen often
    num_views: int = 0  # number of directions, at least 10 degrees apart, of its detections
    colors: tuple[str, ...] = ()  # names, most frequent first; (): no color was measured
    events: tuple[ObjectEvent, ...] = ()  # its history
    jpeg: bytes = b''  # its best picture, of at most 20 kB; b'': none

    @property
    def score(self) -> float:
        """Return the mean score of the detections, in [0, 1]."""
        return sum(score for _, score in self.class_scores) / self.num_sightings

    @property
    def is_present(self) -> bool:
        return self.state.is_at_rest

    @property
    def center_map_m(self) -> FloatArray:
        """Return the center (3,) of the box in the map frame."""
        return self.T_map_object[:3, 3]


class MappedObject:
    """One object, in a frame that moves with a keyframe.

    Attributes:
        left_as: HANDLED or GONE if it is not at its place any more; None: it is at its place.
        left_ns: Stamp of the image that showed this.
        holder_id: Track of the person who handles or moved it; -1: unknown.
        moved_from_m: (3,) center of its box at the previous place, in the object frame; None: it
        was not moved.
        moved_ns: Stamp of the last sighting at the previous place.
        is_loaded: Whether it is from a loaded map.
        track_id: Its track in the object tracker; -1: none.
        was_carried: Whether this track shows that a person carried it to its place.
        memory: Its colors, its best picture and its history.
    """

    def __init__(self, object_id: int, place: Place, stamp_ns: int) -> None:
        self.object_id = object_id
        self.surface, self.evidence = ObjectSurface(place), Evidence(stamp_ns)
        self.left_as: ObjectState | None = None
        self.left_ns, self.holder_id = 0, -1
        self.moved_from_m: FloatArray | None = None
        self.moved_ns = 0
        self.is_loaded = False
        self.track_id, self.was_carried = -1, False
        self.memory = ObjectMemory()
        self.memory.history.continue_from(stamp_ns, 0)

    @property
    def class_name(self) -> str:
        """Return the likeliest class that can have its size, or else the likeliest class."""
        names = self.evidence.class_names
        return next(filter(self._has_size_of, names), names[0])

    def _has_size_of(self, class_name: str) -> bool:
        low_m, high_m = _DIAGONALS_M.get(class_name, (0.0, np.inf))
        return low_m <= 2 * self.surface.radius_m() <= high_m

    @property
    def map_id(self) -> int:
        return self.surface.place.map_id

    @property
    def is_confirmed(self) -> bool:
        """Return whether the evidence is sufficient and the size is plausible for the class."""
        return self.evidence.is_sufficient and self._has_size_of(self.class_name)

    @property
    def is_present(self) -> bool:
        """Return whether the object is at its place, as far as is known."""
        return self.left_as is None

    @property
    def state(self) -> ObjectState:
        is_sure = self.evidence.probability >= _LIKELY or not self.is_present
        if not (self.is_confirmed and is_sure):
            return ObjectState.TENTATIVE
        at_rest = ObjectState.AT_REST if self.moved_from_m is None else ObjectState.MOVED
        return self.left_as or at_rest

    def add(self, segment: Segment, stamp_ns: int, T_map_camera: FloatArray) -> None:
        """Add a detection of the object at its place, with the surface that it shows."""
        self.surface.add(segment, T_map_camera)
        self.note_detected(segment, stamp_ns, T_map_camera)

    def note_detected(self, segment: Segment, stamp_ns: int, T_map_camera: FloatArray) -> None:
        detection, (ray, _) = segment.detection, self.surface.ray_to(segment, T_map_camera)
        self.evidence.add(detection.class_name, detection.score, ray)
        self.note_seen(stamp_ns)

    def note_seen(self, stamp_ns: int) -> None:
        self.evidence.note_seen(stamp_ns)
        if not self.is_present:
            self.left_as, self.holder_id = None, -1

    def note_missed(self, stamp_ns: int) -> None:
        if self.evidence.note_missed() and self.is_confirmed and self.is_present:
            self.leave(ObjectState.GONE, stamp_ns)

    def leave(self, state: ObjectState, stamp_ns: int) -> None:
        if self.is_present:
            self.left_ns = stamp_ns
        self.left_as = state

    def note_state(self, stamp_ns: int) -> None:
        """Add to the history the events that the object's state after an image shows."""
        seen, before_m = self.evidence, self.moved_from_m
        moved_m = 0.0
        if before_m is not None and self.moved_ns != self.memory.history.moved_ns:
            low_m, high_m = self.surface.box_m()
            moved_m = float(np.linalg.norm((low_m + high_m) / 2 - before_m))
        present = PresentState(
            self.state,
            seen.first_ns,
            seen.last_ns,
            self.left_ns,
            self.moved_ns,
            moved_m,
            self.holder_id,
        )
        self.memory.note(present, stamp_ns)

    def is_older_than(self, other: MappedObject) -> bool:
        """Return whether this object was seen first; loaded objects are older than all others."""
        age, other_age = ((not item.is_loaded, item.evidence.first_ns) for item in (self, other))
        return age < other_age

    def absorb(self, other: MappedObject) -> None:
        self.evidence.merge(other.evidence, self.surface.absorb(other.surface))
        self.is_loaded |= other.is_loaded
        self.memory.absorb(other.memory)

    def move_to(self, other: MappedObject) -> None:
        """Take over the place and the evidence of `other`: this object after it was carried.

        The object becomes MOVED. It keeps its number and its history.
        """
        T_object_map = other.surface.place.T_place_map
        self.moved_ns = self.evidence.last_ns
        self.moved_from_m = se3.transform(T_object_map, self.surface.center_map_m()[None])[0]
        R_new_old = (T_object_map @ self.surface.T_map_object)[:3, :3]
        probability = other.evidence.probability
        other.evidence.merge(self.evidence, R_new_old)
        self.surface, self.evidence = other.surface, other.evidence
        self.evidence.probability = probability
        self.track_id, self.was_carried = other.track_id, other.was_carried
        self.left_as = None
        self.memory.move_to(other.memory)

    def value(self, level: Level, floor: Floor | None, *, is_reused: bool = False) -> MapObject:
        """Return the object as it is published; furniture is extended down to `floor`."""
        evidence, T = self.evidence, self.surface.T_map_object
        floor = floor if self.class_name in _STANDING else None
        box, before_m = self.surface.upright_box(level, floor), self.moved_from_m
        names = [name for name in evidence.class_names if self._has_size_of(name)]
        fitting = (n for n in names if box.size_m[2] <= _HEIGHTS_M.get(n, np.inf))
        return MapObject(
            self.object_id,
            next(fitting, self.class_name),
            tuple(sorted(evidence.scores.items(), key=lambda item: -item[1])),
            self.state,
            T @ box.pose,
            box.size_m,
            evidence.num_sightings,
            evidence.first_ns,
            evidence.last_ns,
            evidence.probability,
            self.holder_id,
            None if before_m is None else se3.transform(T, before_m[None])[0],
            self.moved_ns,
            is_reused and not (self.is_loaded or evidence.is_brief),
            len(evidence.views),
            self.memory.color_names,
            self.memory.history.events,
            self.memory.jpeg,
        )
