"""The object map: each object that is or was at rest once, anchored to keyframes.

As in the object map of Khronos (Schmid et al., RSS 2024), an object is the surface inside its
boxes, accumulated over images, and an image that sees through this surface is evidence that the
object is absent. A look is an image in which an object may be seen.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from hoid_common import se3
from hoid_common.poses.keyframe_poses import NO_KEYFRAMES, KeyframePoses
from hoid_common.sync import Rate
from hoid_common.values import (
    NS_PER_S,
    PERSON,
    UNKNOWN,
    ByteArray,
    CameraModel,
    Detections,
    DynamicObject,
    Float32Array,
    IntArray,
    ObjectState,
)
from hoid_scene.config.object_config import ObjectMapConfig
from hoid_scene.dense.cloud_labels import CloudLabeler, CloudLabels
from hoid_scene.grid.floor import Floor
from hoid_scene.level.upright_box import Level
from hoid_scene.memory.object_memory import NO_MEMORIES, Look, MemoryState, ObjectMemory, remember
from hoid_scene.objects.association import (
    Visibility,
    associate,
    expected_boxes,
    in_box,
    look_at,
    missed_rows,
    prior_of,
)
from hoid_scene.objects.carrying import Carrying, within_reach
from hoid_scene.objects.mapped_object import MapObject, MappedObject
from hoid_scene.objects.merging import Merging, may_lie_on
from hoid_scene.objects.object_map_state import ObjectMapState
from hoid_scene.objects.object_view import STRIDE, ObjectCamera, ObjectView
from hoid_scene.objects.segmentation import Segment, segment_all
from hoid_scene.place import Anchor, Place, anchor_at
from hoid_scene.scene_scheduler import SceneRequest
from hoid_scene.tracks.object_track import TrackedObject

_RANGE_M = 7.0  # objects farther from the camera are ignored; chosen
# Numbers without a source were not tuned.
_VISIBLE_RATIO = 0.5  # ratio of visible solid voxels from which on a missing detection counts
# An image shows an object's place if depth is measured at or behind at least the first ratio of
# its solid voxels, and shows it empty if depth is behind at least the second ratio of these. After
# so many images in a row that show it empty, the object is gone.
_SHOWN_RATIO, _THROUGH_RATIO, _MAX_THROUGH = 0.3, 0.6, 5
_CLAIMED_RATIO = 0.5  # a new segment with more of its points near an object's surface is no object
_MERGE_PERIOD_NS = NS_PER_S
_FORGET_NS = 10 * NS_PER_S  # an unconfirmed object that is not seen for so long is forgotten
# An object that has left its place is forgotten if no detector has named its class for so long.
_FORGET_CLASS_NS = 600 * NS_PER_S
_Z = Level(np.array([0.0, 0.0, 1.0]))  # the map frame is level
# Chosen bounds. A voxel takes 44 bytes and an object about 2000 voxels: 90 kB, and 45 MB in all.
_MAX_OBJECTS, _MAX_VOXELS = 1000, 1_000_000


class ObjectMap:
    """Keeps the objects, and updates them with images, tracks and corrections of the map."""

    def __init__(self, camera: CameraModel, min_score: float = 0.0) -> None:
        self._camera, self._min_score = ObjectCamera(camera), min_score
        self._looks = Rate(ObjectMapConfig.look_rate_hz)
        self._images = Rate(ObjectMapConfig.evidence_rate_hz)
        # Expected boxes of known objects in the latest image; None: no image yet.
        self.expected: Detections | None = None
        self._keyframes: KeyframePoses = NO_KEYFRAMES
        self._objects: list[MappedObject] = []
        self._next_id = 1
        self._merging, self._carrying, self._labeler = Merging(), Carrying(), CloudLabeler()
        self._merged_ns = 0  # stamp of the last merging
        self._named_ns: dict[str, int] = {}  # stamp of the last detection of each class
        self._is_reused = False  # whether a map was loaded

    def __len__(self) -> int:
        return len(self._objects)

    @property
    def num_voxels(self) -> int:
        return sum(len(item.surface.voxels) for item in self._objects)

    def objects(
        self, floor: Floor | None = None, level: Level = _Z, *, tentative: bool = False
    ) -> tuple[MapObject, ...]:
        """Return the objects of the main map by id; furniture stands on `floor`."""
        values = (item.value(level, floor, is_reused=self._is_reused) for item in self._shown())
        return tuple(
            item for item in values if tentative or item.state is not ObjectState.TENTATIVE
        )

    def label(self, points_map_m: Float32Array) -> CloudLabels:
        """Return the classes that the objects at rest in the main map give (N, 3) points."""
        known = [item for item in self._shown() if item.state is not ObjectState.TENTATIVE]
        by_size = sorted(known, key=lambda item: item.surface.radius_m())
        at_rest = [
            (item.class_name, item.surface.solid_points_map_m())
            for item in by_size
            if item.is_present
        ]
        classes = list(dict.fromkeys(item.class_name for item in known))
        return self._labeler.label(points_map_m, at_rest, classes)

    def _shown(self) -> list[MappedObject]:
        main = [item for item in self._objects if item.map_id == self._keyframes.main_map]
        return sorted(main, key=lambda item: item.object_id)

    def update(
        self,
        request: SceneRequest,
        depth_m: Float32Array,
        detections: Sequence[DynamicObject],
        tracks: Sequence[TrackedObject] = (),
        image: Callable[[], ByteArray] | None = None,
    ) -> bool:
        """Update the objects with one image; return whether it was used.

        Images must come in order of time.

        `image` returns its colors (H, W, 3); it is called last, and only for colors and pictures
        of objects. None: these are left out.

        All objects are updated at `look_rate_hz`, and objects of uncertain existence at
        `evidence_rate_hz`. The image must have detections (`has_detections`). It is ignored if
        the request has no keyframes, or if its keyframe has been removed since the request.
        Keyframe poses that are not older than the present ones are applied first (`correct`).
        """
        anchor = self._anchor_of(request)
        if anchor is None:
            return False
        stamp_ns, is_look = request.stamp_ns, self._looks.take_due(request.stamp_ns)
        open_ids = {i.object_id for i in self._objects if i.evidence.is_open(stamp_ns)}
        if not (is_look or (open_ids and self._images.take_due(stamp_ns))):
            return False
        view = self._camera.view(depth_m, anchor.T_map_camera)
        measured = [item for item in detections if self._is_measured(item)]
        self._named_ns |= {item.class_name: stamp_ns for item in measured}
        view.fill_screens(depth_m, measured)
        near = self._near(anchor)
        seen = look_at(near, view)
        segments = [
            within_reach(segment, tracks)
            for segment in segment_all(measured, view, prior_of(measured, near, seen, view))
        ]
        pairs = associate(segments, near, seen)
        used = {o for o, item in enumerate(near) if is_look or item.object_id in open_ids}
        for s, o in pairs.items():
            if o in used:
                _add_sighting(near[o], segments[s], seen[o], view, stamp_ns, is_look=is_look)
        self._merging.note_apart([(near[o], segments[s]) for s, o in pairs.items()])
        people = [item for item in measured if item.class_name == PERSON]
        for o in used - set(pairs.values()):
            _note_unseen(near[o], seen[o], people, view, stamp_ns)
        left = [segment for s, segment in enumerate(segments) if s not in pairs and is_look]
        added = self._add_new(left, near, anchor, stamp_ns)
        self._objects = self._carrying.follow(self._objects, tracks, stamp_ns)
        self.expected = expected_boxes(near, seen, stamp_ns)
        if stamp_ns - self._merged_ns >= _MERGE_PERIOD_NS or stamp_ns < self._merged_ns:
            self._merged_ns = stamp_ns
            self.join()
            self._forget(stamp_ns)
        for item in self._objects:
            item.note_state(stamp_ns)
        if image is not None:
            known = [(near[o], segments[s]) for s, o in pairs.items()]
            looks = [
                Look(item.memory, segment.detection, segment.pixels, segment.is_cut)
                for item, segment in known + added
            ]
            remember(looks, people, image, STRIDE, stamp_ns)
        return True

    def _anchor_of(self, request: SceneRequest) -> Anchor | None:
        """Return the pose of an image by its keyframe, after newer keyframe poses are applied."""
        T_keyframe_camera = request.T_keyframe_camera
        if request.keyframes is None or T_keyframe_camera is None:
            return None
        if request.keyframes.version >= self._keyframes.version:
            self.correct(request.keyframes)
        return anchor_at(self._keyframes, request.reference_uid, T_keyframe_camera)

    def correct(self, keyframes: KeyframePoses) -> None:
        """Apply corrected keyframe poses: each object moves with its keyframe."""
        before, self._keyframes = self._keyframes, keyframes
        self._objects = [
            item for item in self._objects if item.surface.place.follow(before, keyframes)
        ]

    def export(self, keyframe_uids: IntArray) -> ObjectMapState:
        """Return the objects for a file; those whose anchor is not saved are left out."""
        return ObjectMapState.of_objects(
            self._objects, keyframe_uids, apart=self._merging.apart, next_id=self._next_id
        )

    def memories(self) -> dict[int, MemoryState]:
        """Return the memory of each object for a file, by the number of the object."""
        return {item.object_id: item.memory.state() for item in self._objects}

    def load(
        self,
        state: ObjectMapState,
        keyframe_uids: IntArray,
        memories: Mapping[int, MemoryState] = NO_MEMORIES,
    ) -> None:
        """Add the objects of a saved map; an object whose number is in use gets a new number."""
        loaded = state.objects(self._keyframes, keyframe_uids)
        _recall(loaded, memories)
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
            self._merging.apart.add((a, b))
        self._objects += loaded
        self._is_reused = True

    def restore(self, loaded_ids: Collection[int], *, is_reused: bool) -> None:
        """Set what the store of a resumed map does not contain: which objects were loaded.

        Args:
            loaded_ids: Numbers of the objects that are from a map of another session.
            is_reused: Whether such a map was loaded.
        """
        self._is_reused = is_reused
        for item in self._objects:
            item.is_loaded = item.object_id in loaded_ids

    @property
    def loaded_ids(self) -> list[int]:
        return [item.object_id for item in self._objects if item.is_loaded]

    @property
    def is_reused(self) -> bool:
        """Return whether a map of another session was loaded."""
        return self._is_reused

    def join(self) -> None:
        """Merge objects at rest that overlap, unless one image showed both; the older id stays."""
        self._objects = self._merging.merged(self._objects)

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

    def _near(self, anchor: Anchor) -> list[MappedObject]:
        same = [item for item in self._objects if item.map_id == anchor.map_id]
        if not same:
            return []
        centers = np.array([item.surface.T_map_object[:3, 3] for item in same])
        local = se3.transform(se3.inverse(anchor.T_map_camera), centers)
        reach = np.array([item.surface.radius_m() for item in same])
        is_near = (np.linalg.norm(local, axis=1) < _RANGE_M) & (local[:, 2] > -reach)
        return [same[i] for i in np.flatnonzero(is_near)]

    def _add_new(
        self,
        segments: Sequence[Segment],
        near: Sequence[MappedObject],
        anchor: Anchor,
        stamp_ns: int,
    ) -> list[tuple[MappedObject, Segment]]:
        """Add an object for each segment that shows no known object; return the pairs of both."""
        added = []
        for segment in segments:
            if segment.detection.is_dynamic or _is_claimed(segment, near):
                continue
            place = Place.at(segment.center_map_m, anchor)
            item = MappedObject(self._take_id(), place, stamp_ns)
            item.add(segment, stamp_ns, anchor.T_map_camera)
            added.append((item, segment))
        self._objects += [item for item, _ in added]
        return added

    def _forget(self, stamp_ns: int) -> None:
        kept = [item for item in self._objects if not self._is_obsolete(item, stamp_ns)]
        if len(kept) > _MAX_OBJECTS or self.num_voxels > _MAX_VOXELS:
            kept.sort(key=lambda item: (not item.is_confirmed, -item.evidence.last_ns))
            total = np.cumsum([len(item.surface.voxels) for item in kept])
            del kept[min(_MAX_OBJECTS, int(np.searchsorted(total, _MAX_VOXELS, 'right'))) :]
        self._objects = kept
        ids = {item.object_id for item in kept}
        self._merging.apart = {pair for pair in self._merging.apart if ids.issuperset(pair)}
        names = {item.class_name for item in kept}
        self._named_ns = {name: at for name, at in self._named_ns.items() if name in names}

    def _is_obsolete(self, item: MappedObject, stamp_ns: int) -> bool:
        """Return whether an unconfirmed object was not seen for 10 s, or whether it has left.

        An object that has left is obsolete if its class was not detected for 10 minutes.
        """
        if not item.is_confirmed:
            return stamp_ns - item.evidence.last_ns >= _FORGET_NS
        named_ns = self._named_ns.setdefault(item.class_name, stamp_ns)
        return not item.is_present and stamp_ns - named_ns >= _FORGET_CLASS_NS


def _recall(objects: Sequence[MappedObject], memories: Mapping[int, MemoryState]) -> None:
    """Give saved objects their memories, whose histories continue from the last sightings."""
    for item in objects:
        if (memory := memories.get(item.object_id)) is not None:
            item.memory = ObjectMemory.of(memory)
        item.memory.history.continue_from(item.evidence.last_ns, item.moved_ns)


def _add_sighting(
    item: MappedObject,
    segment: Segment,
    seen: Visibility,
    view: ObjectView,
    stamp_ns: int,
    *,
    is_look: bool,
) -> None:
    """Add the detection of a known object.

    An object that is not at rest adds no surface, because a person may hide a part of it. An image
    between two looks adds no surface either: it repeats the errors of a look.
    """
    if segment.detection.is_dynamic:
        item.note_seen(stamp_ns)
        return
    if is_look:
        item.surface.count_misses(missed_rows(segment, seen, view))
        item.surface.add(segment, view.T_map_camera)
    item.note_detected(segment, stamp_ns, view.T_map_camera)


def _note_unseen(
    item: MappedObject,
    seen: Visibility,
    people: Sequence[DynamicObject],
    view: ObjectView,
    stamp_ns: int,
) -> None:
    """Update an object that was not detected in an image.

    The image may see through its place, or show its surface without a detection. The latter does
    not count if most of what is visible of it is inside the box of a person.
    """
    shown, through = seen.visible_ratio + seen.through_ratio, seen.through_ratio
    if shown >= _SHOWN_RATIO and through >= _THROUGH_RATIO * shown:
        item.evidence.note_seen_through()
        is_gone = item.evidence.num_through >= _MAX_THROUGH
        if is_gone and item.left_as is not ObjectState.HANDLED:
            item.leave(ObjectState.GONE, stamp_ns)
    elif seen.visible_ratio >= _VISIBLE_RATIO:
        uv = seen.uv_px[seen.is_visible]
        boxes = (view.pixels_of(person.box_xyxy_px) for person in people)
        if not any(in_box(uv, box).mean() > _VISIBLE_RATIO for box in boxes):
            item.note_missed(stamp_ns)


def _is_claimed(segment: Segment, near: Sequence[MappedObject]) -> bool:
    """Return whether a segment shows the surface of a confirmed object that is at rest.

    Objects on which the segment may lie are not considered.
    """
    return any(
        item.is_confirmed
        and item.is_present
        and not may_lie_on(segment.radius_m(), item)
        and item.surface.ratio_near(segment.points_map_m) > _CLAIMED_RATIO
        for item in near
    )
