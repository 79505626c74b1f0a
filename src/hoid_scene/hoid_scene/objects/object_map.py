"""The object map: each object that is or was at rest once, anchored to keyframes.

As in the object map of Khronos (Schmid et al., RSS 2024), an object is the surface inside its
boxes, accumulated over images, and an image that sees through this surface is evidence that the
object is absent. A look is an image in which an object may be seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from hoid_common import se3
from hoid_common.poses.keyframe_poses import NO_KEYFRAMES, KeyframePoses
from hoid_common.values import (
    NS_PER_S,
    PERSON,
    UNKNOWN,
    CameraModel,
    Detections,
    DynamicObject,
    Float32Array,
    IntArray,
    ObjectState,
)
from hoid_scene.grid.floor import Floor
from hoid_scene.level.upright_box import Level
from hoid_scene.objects.association import (
    Visibility,
    are_inside_each_other,
    are_parts_of_a_chair,
    associate,
    expected_boxes,
    in_box,
    is_confusable,
    look_at,
    missed_rows,
    overlap_much,
    prior_of,
    touching,
)
from hoid_scene.objects.carrying import Carrying, is_at_rest, is_brief
from hoid_scene.objects.cloud_labels import CloudLabeler, CloudLabels
from hoid_scene.objects.mapped_object import MapObject, MappedObject
from hoid_scene.objects.object_map_state import ObjectMapState
from hoid_scene.objects.object_view import ObjectCamera, ObjectView
from hoid_scene.objects.place import Anchor, Place
from hoid_scene.objects.segmentation import Segment, segment_all
from hoid_scene.scene_scheduler import SceneRequest
from hoid_scene.tracks.object_track import TrackedObject

_RANGE_M = 7.0  # objects farther from the camera are ignored; chosen
# None of these numbers was tuned where no other source is named.
_VISIBLE_SHARE = 0.5  # of the solid voxels, from which on a missing detection counts
# Share of the solid voxels at which surface is measured, there or behind, from which on an image
# shows the place of an object; share of these from which on the image shows the place empty, and
# number of successive such looks after which the object is gone.
_SHOWN_SHARE, _THROUGH_SHARE, _MAX_THROUGH = 0.3, 0.6, 5
_CLAIMED_SHARE = 0.5  # a new segment with more of its points near an object's surface is no object
_SUPPORT_RATIO = 2.5  # ratio of radii from which on the smaller object may lie on the larger one
_MERGE_PERIOD_NS = NS_PER_S
_MERGE_SHARE = 0.5  # of one object's voxels in the box of the other, from which on they are merged
_MERGE_OTHER_SHARE = 0.8  # the same for classes that detectors do not confuse
_MERGE_MARGIN_M = 0.04  # by which this box is enlarged on each side
_FORGET_NS = 10 * NS_PER_S  # an unconfirmed object that is not seen for so long is forgotten
_Z = Level(np.array([0.0, 0.0, 1.0]))  # the map frame is level
_MAX_OBJECTS = 1000  # chosen: 0.6 MB for a room of 30 objects


class ObjectMap:
    """Keeps the objects, and updates them with images, tracks and corrections of the map.

    Args:
        camera: The camera of depth and color.
        min_score: Detections with lower scores are ignored.
    """

    def __init__(self, camera: CameraModel, min_score: float = 0.0) -> None:
        self._camera, self._min_score = ObjectCamera(camera), min_score
        # Where the latest image should show known objects; None: there was none.
        self.expected: Detections | None = None
        self._keyframes: KeyframePoses = NO_KEYFRAMES
        self._objects: list[MappedObject] = []
        self._next_id = 1
        # Pairs (smaller id first) that one image showed as two objects, so that they never merge.
        self._apart: set[tuple[int, int]] = set()
        self._merged_ns = 0  # stamp of the last merging
        self._is_reused = False  # whether a map was loaded
        self._carrying = Carrying()
        self._labeler = CloudLabeler()

    def __len__(self) -> int:
        return len(self._objects)

    def objects(self, floor: Floor | None = None, level: Level = _Z) -> tuple[MapObject, ...]:
        """Return the confirmed objects of the main map by id; furniture stands on `floor`."""
        return tuple(
            item.value(
                level, floor, is_new=self._is_reused and not (item.is_loaded or is_brief(item))
            )
            for item in self._shown()
        )

    def label(self, points_map_m: Float32Array) -> CloudLabels:
        """Return the classes that confirmed objects at rest in the main map give (N, 3) points."""
        present = [item for item in self._shown() if item.is_present]
        return self._labeler.label(points_map_m, present)

    def _shown(self) -> list[MappedObject]:
        """Return the confirmed objects of the main map, by id."""
        return [
            item
            for item in sorted(self._objects, key=lambda item: item.object_id)
            if item.is_confirmed and item.place.map_id == self._keyframes.main_map
        ]

    def update(
        self,
        request: SceneRequest,
        depth_m: Float32Array,
        detections: Sequence[DynamicObject],
        tracks: Sequence[TrackedObject] = (),
    ) -> None:
        """Update the objects with one image; images must come in order of time.

        The image is ignored if the request has no keyframes, or if its keyframe has been removed
        since the request. Keyframe poses that are not older than the present ones are applied
        first (`correct`).

        Args:
            request: Time, pose and keyframe of the image.
            depth_m: (H, W) depth; 0: no reading.
            detections: The detections, with the filter's verdicts.
            tracks: The tracks of people and objects at this time.
        """
        if request.keyframes is None:
            return
        if request.keyframes.version >= self._keyframes.version:
            self.correct(request.keyframes)
        anchor = self._anchor(request, request.keyframes)
        if anchor is None:
            return
        stamp_ns, view = request.stamp_ns, self._camera.view(depth_m, anchor.T_map_camera)
        measured = [item for item in detections if self._is_measured(item)]
        view.fill_screens(depth_m, measured)
        near = self._near(anchor)
        seen = look_at(near, view)
        segments = segment_all(measured, view, prior_of(measured, near, seen, view))
        pairs = associate(segments, near, seen)
        for s, o in pairs.items():
            at_rest = not segments[s].detection.is_dynamic
            if not near[o].is_confirmed:
                at_rest = is_at_rest(segments[s], tracks, stamp_ns)
            self._add_sighting(near[o], segments[s], seen[o], view, stamp_ns, at_rest)
        self._note_apart([(near[o], segments[s]) for s, o in pairs.items()])
        people = [item for item in measured if item.class_name == PERSON]
        for o in set(range(len(near))) - set(pairs.values()):
            self._note_unseen(near[o], seen[o], people, view, stamp_ns)
        left = [segment for s, segment in enumerate(segments) if s not in pairs]
        self._add_new(left, near, anchor, tracks, stamp_ns)
        self._objects = self._carrying.follow(self._objects, tracks, stamp_ns)
        self.expected = expected_boxes(near, seen, stamp_ns)
        if stamp_ns - self._merged_ns >= _MERGE_PERIOD_NS or stamp_ns < self._merged_ns:
            self._merged_ns = stamp_ns
            self._merge()
            self._forget(stamp_ns)

    def correct(self, keyframes: KeyframePoses) -> None:
        """Apply corrected keyframe poses: each object moves with its keyframe.

        The objects of a map whose keyframes were all removed are forgotten.
        """
        before, self._keyframes = self._keyframes, keyframes
        self._objects = [item for item in self._objects if item.place.follow(before, keyframes)]

    def export(self, keyframe_uids: IntArray) -> ObjectMapState:
        """Return the objects for a file; those whose anchor is not saved are left out.

        Args:
            keyframe_uids: (K,) ascending uids of the saved keyframes.
        """
        return ObjectMapState.of_objects(
            self._objects, keyframe_uids, apart=self._apart, next_id=self._next_id
        )

    def load(self, state: ObjectMapState, keyframe_uids: IntArray) -> None:
        """Add the objects of a saved map, whose keyframes the last `correct` must have contained.

        They keep their numbers, unless a confirmed object of this map has the same one. Then the
        saved object gets a new number. An unconfirmed object of this map with the number of a
        saved one gets a new number.

        Args:
            state: The saved objects.
            keyframe_uids: (K,) present uids of the keyframes, in the order of the saved map.
        """
        loaded = state.objects(self._keyframes, keyframe_uids)
        self._next_id = max(self._next_id, int(state.next_id[0]))
        taken = {item.object_id for item in self._objects if item.is_confirmed}
        new_ids = {item.object_id: self._take_id() for item in loaded if item.object_id in taken}
        used = {item.object_id for item in loaded} - new_ids.keys()
        for item in self._objects:
            if item.object_id in used:  # not confirmed, and therefore not published
                item.object_id = self._take_id()
        for item in loaded:
            item.object_id = new_ids.get(item.object_id, item.object_id)
            item.is_loaded = True
        for pair in state.apart.tolist():
            a, b = sorted(new_ids.get(i, i) for i in pair)
            self._apart.add((a, b))
        self._objects += loaded
        self._is_reused = True

    def join(self) -> None:
        """Merge objects at rest that overlap, unless one image showed both; the older id stays."""
        self._merge()

    def forget(self, object_id: int) -> bool:
        """Remove the object with this number; return whether there was one."""
        before = len(self)
        self._objects = [item for item in self._objects if item.object_id != object_id]
        return len(self) < before

    def _is_measured(self, item: DynamicObject) -> bool:
        """Return whether a box was detected, not predicted, and its class and score are usable."""
        is_detected = item.state is not ObjectState.PREDICTED and item.class_name != UNKNOWN
        return is_detected and item.score >= self._min_score

    def _take_id(self) -> int:
        self._next_id += 1
        return self._next_id - 1

    def _anchor(self, request: SceneRequest, keyframes: KeyframePoses) -> Anchor | None:
        """Return the keyframe of a request and the present pose of its image.

        None is returned if the keyframe has been removed.

        Args:
            request: The request.
            keyframes: The keyframe poses to which the pose of the request belongs.
        """
        uid = request.reference_uid
        old, new = keyframes.row_of(uid), self._keyframes.row_of(uid)
        if old is None or new is None:
            return None
        T_map_keyframe = self._keyframes.T_map_camera[new]
        T_keyframe_camera = se3.inverse(keyframes.T_map_camera[old]) @ request.T_map_camera
        map_id = int(self._keyframes.map_ids[new])
        return Anchor(uid, map_id, T_map_keyframe, T_map_keyframe @ T_keyframe_camera)

    def _add_sighting(
        self,
        item: MappedObject,
        segment: Segment,
        seen: Visibility,
        view: ObjectView,
        stamp_ns: int,
        at_rest: bool,
    ) -> None:
        """Add the detection of a known object.

        One that is not at rest adds no surface, because a person may hide a part of it.
        """
        if not at_rest:
            item.note_seen(stamp_ns)
        else:
            item.count_misses(missed_rows(segment, seen, view))
            item.add(segment, stamp_ns, view.T_map_camera)
        self._carrying.note_seen(item)

    def _near(self, anchor: Anchor) -> list[MappedObject]:
        """Return the objects of the image's map that may be in view."""
        same = [item for item in self._objects if item.place.map_id == anchor.map_id]
        if not same:
            return []
        centers = np.array([item.T_map_object[:3, 3] for item in same])
        local = se3.transform(se3.inverse(anchor.T_map_camera), centers)
        reach = np.array([item.radius_m() for item in same])
        is_near = (np.linalg.norm(local, axis=1) < _RANGE_M) & (local[:, 2] > -reach)
        return [same[i] for i in np.flatnonzero(is_near)]

    def _note_unseen(
        self,
        item: MappedObject,
        seen: Visibility,
        people: Sequence[DynamicObject],
        view: ObjectView,
        stamp_ns: int,
    ) -> None:
        """Record what an image shows of an object that was not detected in it.

        The image may see through its place, or show its surface without a detection. The latter
        does not count if most of what is visible of it is inside the box of a person.
        """
        shown, through = seen.visible_share + seen.through_share, seen.through_share
        if shown >= _SHOWN_SHARE and through >= _THROUGH_SHARE * shown:
            item.note_seen_through()
            if item.num_through >= _MAX_THROUGH and item.state is not ObjectState.HANDLED:
                item.leave(ObjectState.GONE, stamp_ns)
        elif seen.visible_share >= _VISIBLE_SHARE:
            uv = seen.uv_px[seen.is_visible]
            boxes = (view.pixels_of(person.box_xyxy_px) for person in people)
            if not any(in_box(uv, box).mean() > _VISIBLE_SHARE for box in boxes):
                item.note_missed(stamp_ns)

    def _add_new(
        self,
        segments: Sequence[Segment],
        near: Sequence[MappedObject],
        anchor: Anchor,
        tracks: Sequence[TrackedObject],
        stamp_ns: int,
    ) -> None:
        """Start an object for each static segment that `_is_claimed` assigns to no object."""
        for segment in segments:
            if not is_at_rest(segment, tracks, stamp_ns) or self._is_claimed(segment, near):
                continue
            place = Place.at(segment.center_map_m, anchor)
            item = MappedObject(self._take_id(), place, stamp_ns)
            item.add(segment, stamp_ns, anchor.T_map_camera)
            self._objects.append(item)

    def _is_claimed(self, segment: Segment, near: Sequence[MappedObject]) -> bool:
        """Return whether a segment shows the surface of a confirmed object that is at rest.

        Objects that are so much larger that the segment may lie on them are not considered.
        """
        largest_m = _SUPPORT_RATIO * segment.radius_m()
        for item in near:
            if not (item.is_confirmed and item.is_present) or item.radius_m() > largest_m:
                continue
            if item.surface_share(segment.points_map_m) > _CLAIMED_SHARE:
                return True
        return False

    def _note_apart(self, seen: Sequence[tuple[MappedObject, Segment]]) -> None:
        """Record the pairs of objects that one image shows as two objects."""
        for (first, one), (second, other) in combinations(seen, 2):
            a, b = sorted((first.object_id, second.object_id))
            if (a, b) not in self._apart and not overlap_much(one.box_px, other.box_px):
                self._apart.add((a, b))

    def _merge(self) -> None:
        """Merge objects that overlap, unless an image showed both beside each other."""
        by_size = sorted(self._objects, key=lambda item: -item.num_sightings)
        gone: set[int] = set()
        for i, j in np.argwhere(np.triu(touching(by_size), 1)).tolist():
            first, second = by_size[i], by_size[j]
            if first.object_id in gone or second.object_id in gone:
                continue
            if self._are_one(first, second):
                if second.is_older_than(first):
                    first.object_id, second.object_id = second.object_id, first.object_id
                first.absorb(second)
                gone.add(second.object_id)
                self._rename_apart(second.object_id, first.object_id)
        if gone:
            self._objects = [item for item in self._objects if item.object_id not in gone]

    def _are_one(self, first: MappedObject, second: MappedObject) -> bool:
        is_same_map = first.place.map_id == second.place.map_id
        if not (first.is_present and second.is_present and is_same_map):
            return False
        ids = sorted((first.object_id, second.object_id))
        if (ids[0], ids[1]) in self._apart:
            return are_inside_each_other(first, second)
        is_alike = is_confusable(first.class_name, second.class_name)
        small, large = sorted((first.radius_m(), second.radius_m()))
        if not is_alike and large > _SUPPORT_RATIO * small:
            return False  # the small one lies on the large one
        share = max(
            first.contains(second.points_map_m(), _MERGE_MARGIN_M),
            second.contains(first.points_map_m(), _MERGE_MARGIN_M),
        )
        least = _MERGE_SHARE if is_alike else _MERGE_OTHER_SHARE
        return share >= least or are_parts_of_a_chair(first, second)

    def _rename_apart(self, old: int, new: int) -> None:
        moved = {pair for pair in self._apart if old in pair}
        self._apart -= moved
        for pair in moved:
            a, b = sorted(new if i == old else i for i in pair)
            if a != b:
                self._apart.add((a, b))

    def _forget(self, stamp_ns: int) -> None:
        """Forget unconfirmed objects unseen for 10 s, and objects beyond the largest number."""
        self._objects = [
            item
            for item in self._objects
            if item.is_confirmed or stamp_ns - item.last_ns < _FORGET_NS
        ]
        if len(self._objects) > _MAX_OBJECTS:
            self._objects.sort(key=lambda item: (item.is_confirmed, item.last_ns))
            del self._objects[: len(self._objects) - _MAX_OBJECTS]
        ids = {item.object_id for item in self._objects}
        self._apart = {pair for pair in self._apart if pair[0] in ids and pair[1] in ids}
