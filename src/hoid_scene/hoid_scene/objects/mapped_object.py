"""One object of the object map: its voxels, its classes and its history."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hoid_common import se3
from hoid_common.values import NS_PER_S, BoolArray, FloatArray, IntArray, ObjectState
from hoid_native import pixels_on_surface, share_on_surface, voxel_keys
from hoid_scene.grid.floor import Floor
from hoid_scene.level.upright_box import Level, UprightBox, extended_back, on_floor, upright_box
from hoid_scene.objects.object_view import NOISE_PER_M2, ObjectView, Views
from hoid_scene.objects.place import Place
from hoid_scene.objects.segmentation import BoxPx, KnownBox, Segment
from hoid_scene.objects.voxel_set import BITS, VoxelSet, trimmed_box

# None of these numbers was tuned where no other source is named. A look is an image in which the
# object may be seen, a sighting one in which it was detected. A published object has at least so
# many sightings, and at least this time between the first and the last one.
_MIN_SIGHTINGS, _MIN_AGE_NS = 3, NS_PER_S * 2 // 5
# Sum of scores from which on an object is sure (`Views`); most wrong ones on real clips have less.
_SURE = 1.9
_MIN_SEEN_SHARE = 0.5  # of the looks that show its surface, in which it must have been detected
# An object with at least so many sightings is kept, as one that is gone, after it was not detected
# in so many successive looks at its place and in more than half of all looks.
_MANY_SIGHTINGS, _MISSING_LOOKS = 6, 4
_OUTER_SHARE = 0.02  # of the voxels on each side of each axis, which the box leaves out
_CELL_M = 0.05  # side of the cells of the surface of an object
# Furniture, whose legs are rarely seen: its box is extended down to the floor.
_STANDING = frozenset({'chair', 'couch', 'dining table', 'bed', 'bench'})
_CELL_SIGMAS = 2.0  # side of the cells in which hits are counted, in standard deviations of depth
# By how much a known object may grow on each side in a look: length, and share of its size.
_GROWTH_M, _GROWTH_SHARE = 0.05, 0.15
_MIN_DISTANCE_M = 1e-6  # avoids a division by zero
_SAME_UP = 0.01  # chosen: 0.6 degrees; a box is fitted again if the vertical turns by more
# Effect of a look on the probability that the object is still there: gain towards 1 of a sighting,
# relative loss by a missed detection and by a look that shows the place empty.
_SEEN_GAIN, _MISSED_LOSS, _THROUGH_LOSS = 0.3, 0.03, 0.35


@dataclass(frozen=True, eq=False)
class MapObject:
    """The published value of an object of the map."""

    object_id: int
    class_name: str  # the class with the largest sum of scores
    class_scores: tuple[tuple[str, float], ...]  # sums of the scores of each class, largest first
    state: ObjectState
    T_map_object: FloatArray  # (4, 4) pose of the center of the box, whose z axis points up
    size_m: FloatArray  # (3,) extent along the axes of the box
    num_sightings: int  # number of images in which it was detected at rest
    first_ns: int  # stamp of the first sighting
    last_ns: int  # stamp of the last sighting
    probability: float  # that it is still there, in [0, 1]
    holder_id: int = -1  # track of the person who handles or moved it; -1: unknown
    # (3,) center of its box at the place before, in the map frame; None: it was not moved.
    moved_from_map_m: FloatArray | None = None
    moved_ns: int = 0  # stamp of its last sighting at the place before; 0: it was not moved
    is_new: bool = False  # whether a loaded map did not contain it, although it is seen often
    num_views: int = 0  # number of directions, at least 10 degrees apart, of its detections

    @property
    def score(self) -> float:
        """Mean score of the detections, in [0, 1]."""
        return sum(score for _, score in self.class_scores) / self.num_sightings

    @property
    def is_present(self) -> bool:
        """Return whether the object is at rest: AT_REST or MOVED."""
        return self.state.is_at_rest

    @property
    def center_map_m(self) -> FloatArray:
        """Return the center (3,) of the box in the map frame."""
        return self.T_map_object[:3, 3]


class MappedObject:
    """One object: the evidence of all looks at it, in a frame that moves with a keyframe.

    Args:
        object_id: Number of the object.
        place: The object frame.
        stamp_ns: Time of the first detection.
    """

    def __init__(self, object_id: int, place: Place, stamp_ns: int) -> None:
        self.object_id = object_id
        self.state = ObjectState.AT_REST
        self.scores: dict[str, float] = {}  # sum of the detections' scores, by class
        # Images in which it was detected with its surface, and those that showed its surface.
        self.num_sightings = self.num_visible = 0
        self.first_ns = self.last_ns = stamp_ns
        self.num_through = 0  # successive looks that showed its place empty
        self.num_absent = 0  # successive looks at its place, empty or not, without a detection
        self.was_carried = False  # whether its track shows that a person carried it to its place
        self.probability = 0.5  # that it is still at its place
        self.place, self.voxels = place, VoxelSet()
        # Sum over the sightings of the unit vectors from the camera to it, in the object frame.
        self.direction_m: FloatArray = np.zeros(3)
        self.distance_m = 0.0  # sum over the sightings of its distance from the camera
        self.evidence = 0.0  # sum of the scores of detections that are independent (`Views`)
        self._views = Views()
        self.track_id = -1  # of its track in the object tracker; -1: none
        self.holder_id = -1  # track of the person who handles or moved it; -1: unknown
        self.moved_from_m: FloatArray | None = None  # (3,) center before, in the object frame
        self.moved_ns = 0  # stamp of the last sighting at the place before
        self.left_ns = 0  # stamp at which it was found to have left its place
        self.is_loaded = False  # whether it is from a loaded map
        self.is_cut = True  # whether the border of the image has cut it in each sighting
        # Cached, until the voxels change or the object moves with its keyframe:
        self._class_name: str | None = None
        self._center_map: tuple[FloatArray, FloatArray] | None = None  # with the pose it is for
        self._box: tuple[FloatArray, FloatArray] | None = None
        self._center_m, self._radius_m = np.zeros(3), 0.0
        self._upright: tuple[Level, UprightBox] | None = None  # with the vertical it is for
        self._solid: BoolArray | None = None
        self._cells: IntArray | None = None

    @property
    def T_map_object(self) -> FloatArray:  # noqa: N802 - a transform's name
        """Return the pose (4, 4) of the object's frame."""
        return self.place.T_map_object

    @property
    def class_name(self) -> str:
        """Return the class with the largest sum of detection scores."""
        if self._class_name is None:
            self._class_name = max(self.scores, key=self.scores.__getitem__)
        return self._class_name

    @property
    def is_confirmed(self) -> bool:
        """Return whether the object was detected often and long enough to be published."""
        is_old = self.last_ns - self.first_ns >= _MIN_AGE_NS
        is_often = self.num_sightings >= _MIN_SIGHTINGS and self.evidence >= _SURE
        share = self.num_sightings / max(self.num_visible, 1)
        return is_old and is_often and share >= _MIN_SEEN_SHARE

    @property
    def _is_missing(self) -> bool:
        """Return whether a known object was not detected for long where a surface was seen.

        The place of a flat object that was taken does not look empty.
        """
        is_known = self.num_sightings >= _MANY_SIGHTINGS and self.num_absent >= _MISSING_LOOKS
        return is_known and self.num_sightings <= _MIN_SEEN_SHARE * self.num_visible

    @property
    def is_present(self) -> bool:
        """Return whether the object is at rest: AT_REST or MOVED."""
        return self.state.is_at_rest

    def box_m(self) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and the highest corner (3,) [m] of the measured box, object frame.

        It is the bounding box of the solid voxels, or of all voxels if none is solid, without the
        2 % outermost ones on each side.
        """
        if self._box is None:
            solid = self.is_solid()
            points_m = self.voxels.means_m[solid] if solid.any() else self.voxels.means_m
            low, high = self._box = trimmed_box(points_m, _OUTER_SHARE)
            self._center_m = (low + high) / 2
            self._radius_m = float(np.linalg.norm(high - low) / 2)
        return self._box

    def is_solid(self) -> BoolArray:
        """Return the (N,) mask of the voxels that belong to the object."""
        if self._solid is None:
            mean_m = self.distance_m / max(self.num_sightings, 1)
            cell_m = _CELL_SIGMAS * NOISE_PER_M2 * mean_m**2
            self._solid = self.voxels.solid(self.num_sightings, cell_m)
        return self._solid

    def known_box(self) -> KnownBox:
        """Return the measured box, enlarged by as much as it may grow in one image."""
        low, high = self.box_m()
        margin = _GROWTH_M + _GROWTH_SHARE * (high - low)
        return KnownBox(self.place.T_object_map, low - margin, high + margin)

    def points_map_m(self) -> FloatArray:
        """Return the (N, 3) mean points of all voxels in the map frame."""
        return se3.transform(self.T_map_object, self.voxels.means_m)

    def solid_points_map_m(self) -> FloatArray:
        """Return the (N, 3) mean points of the voxels that belong to it, in the map frame."""
        return se3.transform(self.T_map_object, self.voxels.means_m[self.is_solid()])

    def center_map_m(self) -> FloatArray:
        """Return the center (3,) of the measured box in the map frame."""
        T = self.T_map_object
        if self._center_map is None or self._center_map[0] is not T:
            self.box_m()
            self._center_map = T, T[:3, :3] @ self._center_m + T[:3, 3]
        return self._center_map[1]

    def radius_m(self) -> float:
        """Return the radius [m] of the sphere around the measured box."""
        self.box_m()
        return self._radius_m

    def contains(self, points_map_m: FloatArray, margin_m: float) -> float:
        """Return the share of points (N, 3) of the map frame that are in the measured box.

        Args:
            points_map_m: (N, 3) points.
            margin_m: Length by which the box is enlarged on each side.
        """
        low, high = self.box_m()
        local_m = se3.transform(self.place.T_object_map, points_map_m)
        is_inside = ((local_m > low - margin_m) & (local_m < high + margin_m)).all(axis=1)
        return int(np.count_nonzero(is_inside)) / max(len(points_map_m), 1)

    def surface_pixels(self, view: ObjectView, box_px: BoxPx) -> IntArray:
        """Return the flat strided pixels (M,) in a box within 5 cm cells of its solid voxels."""
        return pixels_on_surface(view.depth_m, view.points_map_m, box_px, *self._surface())

    def surface_share(self, points_map_m: FloatArray) -> float:
        """Return the share of points (N, 3) of the map frame that are near its surface."""
        return share_on_surface(points_map_m, *self._surface())

    def _surface(self) -> tuple[FloatArray, IntArray, float, int]:
        """Return T_object_map, and keys, side and bits of the cells that contain solid voxels."""
        if self._cells is None:
            solid_m = self.voxels.means_m[self.is_solid()]
            self._cells = np.unique(voxel_keys(solid_m, _CELL_M, BITS))
        return self.place.T_object_map, self._cells, _CELL_M, BITS

    def add(self, segment: Segment, stamp_ns: int, T_map_camera: FloatArray) -> None:
        """Add a detection of the object at its place.

        Args:
            segment: The detection, with the surface that it shows.
            stamp_ns: Time of the image.
            T_map_camera: (4, 4) pose of the image.
        """
        self.voxels.add_points(se3.transform(self.place.T_object_map, segment.points_map_m))
        self.num_sightings += 1
        self.num_visible += 1
        self.is_cut &= segment.is_cut
        name = segment.detection.class_name
        self.scores[name] = self.scores.get(name, 0.0) + segment.detection.score
        way = self.T_map_object[:3, :3].T @ (segment.center_map_m - T_map_camera[:3, 3])
        distance_m = max(float(np.linalg.norm(way)), _MIN_DISTANCE_M)
        self.direction_m = self.direction_m + way / distance_m
        self.distance_m += distance_m
        self.evidence += self._views.weight(way / distance_m) * segment.detection.score
        self.note_seen(stamp_ns)
        self._changed()

    def note_seen(self, stamp_ns: int) -> None:
        """Record a detection at its place, which may show nothing of its surface."""
        self.last_ns = stamp_ns
        self.num_through = self.num_absent = 0
        self.probability += _SEEN_GAIN * (1 - self.probability)

    def count_misses(self, rows: IntArray) -> None:
        """Count a look that showed that voxels do not belong to the object.

        Args:
            rows: (M,) rows of these voxels.
        """
        self.voxels.count_misses(rows)
        self._changed()

    def _changed(self) -> None:
        self._box = self._solid = self._cells = self._center_map = self._class_name = None
        self._upright = None

    def note_missed(self, stamp_ns: int) -> None:
        """Count a look that shows a surface at its place, but in which it was not detected.

        An object with many sightings is GONE when more such looks would make it unconfirmed.
        """
        self.num_through = 0
        self.num_absent += 1
        if not self._is_missing:
            self.num_visible += 1
        elif self.is_confirmed and self.is_present:
            self.leave(ObjectState.GONE, stamp_ns)
        self.probability *= 1 - _MISSED_LOSS

    def note_seen_through(self) -> None:
        """Count a look that shows its place empty."""
        self.num_through += 1
        self.num_absent += 1
        self.probability *= 1 - _THROUGH_LOSS

    def is_older_than(self, other: MappedObject) -> bool:
        """Return whether this object is older than another one.

        Objects of a loaded map are older than others; otherwise the first sightings are compared.
        """
        return (not self.is_loaded, self.first_ns) < (not other.is_loaded, other.first_ns)

    def absorb(self, other: MappedObject) -> None:
        """Add the evidence of another object that is the same thing at the same place."""
        T = self.place.T_object_map @ other.T_map_object
        self.voxels.merge(other.voxels.moved(T))
        for name, score in other.scores.items():
            self.scores[name] = self.scores.get(name, 0.0) + score
        self.num_sightings += other.num_sightings
        self.evidence += other.evidence
        self.num_visible += other.num_visible
        self.first_ns = min(self.first_ns, other.first_ns)
        self.last_ns = max(self.last_ns, other.last_ns)
        self.is_loaded |= other.is_loaded
        self.is_cut &= other.is_cut
        self.probability = max(self.probability, other.probability)
        self.direction_m = self.direction_m + T[:3, :3] @ other.direction_m
        self.distance_m += other.distance_m
        self._changed()

    def move_to(self, other: MappedObject) -> None:
        """Take over the place and the evidence of another object: this one, after it was carried.

        The object becomes MOVED. It keeps its number and its history.
        """
        before_m, self.moved_ns = self.center_map_m(), self.last_ns
        self.place = other.place
        self.moved_from_m = np.asarray(se3.transform(self.place.T_object_map, before_m[None])[0])
        self.voxels, self.direction_m = other.voxels, other.direction_m
        for name, score in other.scores.items():
            self.scores[name] = self.scores.get(name, 0.0) + score
        # Distances and directions are means over the sightings at the present place: their sums
        # are scaled to the number of all sightings.
        self.distance_m = other.distance_m * (1 + self.num_sightings / other.num_sightings)
        self.direction_m *= 1 + self.num_sightings / other.num_sightings
        self.num_sightings += other.num_sightings
        self.evidence += other.evidence
        self.num_visible += other.num_visible
        self.last_ns, self.track_id = other.last_ns, other.track_id
        self.probability, self.num_through, self.num_absent = other.probability, 0, 0
        self.was_carried, self.is_cut = other.was_carried, other.is_cut
        self.state = ObjectState.MOVED
        self._changed()

    def leave(self, state: ObjectState, stamp_ns: int) -> None:
        """Record that the object is not at its place any more.

        Args:
            state: HANDLED or GONE.
            stamp_ns: Time of the image that showed this.
        """
        if self.is_present:
            self.left_ns = stamp_ns
        self.state = state

    def value(self, level: Level, floor: Floor | None, *, is_new: bool = False) -> MapObject:
        """Return the published value.

        Args:
            level: The vertical and the heading of the walls, in the map frame.
            floor: The floor, down to which furniture reaches; None: it is unknown.
            is_new: Whether a loaded map did not contain the object, although it is seen often.
        """
        box, T = self._full_box(level, floor), self.T_map_object
        before_m = self.moved_from_m
        scores = tuple(sorted(self.scores.items(), key=lambda item: -item[1]))
        return MapObject(
            self.object_id,
            self.class_name,
            scores,
            self.state,
            T @ box.pose,
            box.size_m,
            self.num_sightings,
            self.first_ns,
            self.last_ns,
            self.probability,
            self.holder_id,
            None if before_m is None else se3.transform(T, before_m[None])[0],
            self.moved_ns,
            is_new,
            len(self._views),
        )

    def _full_box(self, level: Level, floor: Floor | None) -> UprightBox:
        """Return the upright box, object frame, with its unseen back and the legs of furniture."""
        box = self._upright_box(level.turned(self.T_map_object[:3, :3].T))
        box = extended_back(box, self.direction_m / max(self.num_sightings, 1))
        if floor is None or self.class_name not in _STANDING:
            return box
        center_m = se3.transform(self.T_map_object, box.center_m[None])[0]
        return on_floor(box, floor.distance_m(center_m))

    def _upright_box(self, level: Level) -> UprightBox:
        """Return the upright box of the solid voxels, or of all voxels if none is solid."""
        known = self._upright
        if known is None or np.abs(known[0].up - level.up).max() > _SAME_UP:
            solid = self.is_solid()
            means_m = self.voxels.means_m[solid] if solid.any() else self.voxels.means_m
            known = self._upright = level, upright_box(means_m, level)
        return known[1]
