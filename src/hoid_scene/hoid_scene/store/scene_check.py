"""Checks of the scene in a map file, so that no file can harm the program."""

from __future__ import annotations

import numpy as np

from hoid_common.io.image_size import image_size_px, is_jpeg, is_safe_to_decode
from hoid_common.io.stamps import END_STAMP_NS
from hoid_common.store.checks import (
    MAX_COUNT,
    MAX_POSITION_M,
    MAX_WEIGHT,
    MIN_WEIGHT,
    are_poses,
    require,
    within,
)
from hoid_common.values import ObjectState
from hoid_scene.dense.submap import SPAN
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.memory.history import MAX_EVENTS, EventKind
from hoid_scene.memory.object_memory import MAX_JPEG_BYTES, MAX_SIDE_PX, MemoryState
from hoid_scene.objects.object_map_state import ObjectMapState, decoded
from hoid_scene.objects.voxel_set import NUM_KEYS

_ROUNDING = 1e-6  # chosen: by which a sum of probabilities may exceed 1


def check_submaps(state: SubmapState) -> None:
    """Raise MapFileError if the submaps of a dense map break a rule; its text names this rule."""
    require(within(state.voxel_m, 1e-3, 1.0), 'the size of a voxel is out of range')
    require((state.anchor >= 0).all(), 'a submap has no keyframe')
    require(are_poses(state.T_anchor_submap), "a submap's pose is invalid")
    require((state.num_voxels > 0).all(), 'a submap has no voxels')
    total = int(state.num_voxels.sum(dtype=np.int64))
    require(total == len(state.key), 'the numbers of voxels do not add up')
    require(within(state.key, 0, SPAN**3), 'a voxel is outside of its submap')
    is_first = np.isin(np.arange(total - 1) + 1, np.cumsum(state.num_voxels))
    require((is_first | (np.diff(state.key) > 0)).all(), 'voxels are not sorted')
    require(within(state.weight, MIN_WEIGHT, MAX_WEIGHT), 'a weight is invalid')


def check_objects(state: ObjectMapState) -> None:
    """Raise MapFileError if the arrays of an object map break a rule; its text names this rule."""
    require(within(state.next_id, 1, MAX_COUNT), 'the next number of an object is out of range')
    require(within(state.object_id, 1, int(state.next_id[0])), "an object's number is invalid")
    require(len(np.unique(state.object_id)) == len(state), 'two objects have the same number')
    require((state.anchor >= 0).all(), 'an object has no keyframe')
    require(are_poses(state.T_anchor_object), "an object's pose is invalid")
    left = [state.value for state in (ObjectState.AT_REST, ObjectState.HANDLED, ObjectState.GONE)]
    require(np.isin(state.left_as, left).all(), "an object's state is unknown")
    for name in ('num_sightings', 'num_visible', 'num_looks'):
        require(within(getattr(state, name), 1, MAX_COUNT), f"an object's {name} is invalid")
    for name in ('first_ns', 'last_ns', 'left_ns', 'moved_ns'):
        require(within(getattr(state, name), 0, END_STAMP_NS), 'a time stamp is out of range')
    require(within(state.num_through, 0, MAX_COUNT), "an object's num_through is invalid")
    require(within(state.probability, 0, 1 + _ROUNDING), 'a probability is invalid')
    require(within(state.distance_m, 0, MAX_POSITION_M), "an object's distance is invalid")
    for vectors in (state.direction_m, state.moved_from_m):
        require(within(np.abs(vectors), 0, MAX_POSITION_M), 'an object has an invalid vector')
    _check_classes(state)
    _check_views(state)
    _check_object_voxels(state)


def _check_classes(state: ObjectMapState) -> None:
    require((state.num_classes > 0).all(), 'an object has no class')
    total = int(state.num_classes.sum(dtype=np.int64))
    require(total == len(state.class_score), 'the numbers of classes do not add up')
    require(within(state.class_score, MIN_WEIGHT, MAX_WEIGHT), 'a score is invalid')
    try:
        names = [decoded(name) for name in state.class_name]
    except UnicodeDecodeError:
        names = ['']
    require(all(name.isprintable() and name for name in names), 'the name of a class is invalid')


def _check_views(state: ObjectMapState) -> None:
    total = int(state.num_views.sum(dtype=np.int64))
    is_complete = (state.num_views >= 0).all() and total == len(state.view_count)
    require(is_complete, 'the numbers of views do not add up')
    require(within(np.abs(state.view), 0, 1 + _ROUNDING), 'a view is invalid')
    require(within(state.view_count, 1, MAX_COUNT), 'the count of a view is invalid')


def _check_object_voxels(state: ObjectMapState) -> None:
    require((state.num_voxels > 0).all(), 'an object has no voxels')
    total = int(state.num_voxels.sum(dtype=np.int64))
    require(total == len(state.key), 'the numbers of voxels do not add up')
    require(within(state.key, 0, NUM_KEYS), 'a voxel is too far from its object')
    is_first = np.isin(np.arange(total - 1) + 1, np.cumsum(state.num_voxels))
    require((is_first | (np.diff(state.key) > 0)).all(), 'voxels are not sorted')
    require(within(np.abs(state.means_m), 0, MAX_POSITION_M), 'a point of a voxel is invalid')
    require(within(state.readings, MIN_WEIGHT, MAX_WEIGHT), 'a number of readings is invalid')
    for counts in (state.hits, state.misses):
        require(within(counts, 0, MAX_WEIGHT), 'the evidence of a voxel is invalid')


def check_memory(state: MemoryState) -> None:
    """Raise MapFileError if the memory of an object breaks a rule; its text names this rule."""
    require(len(state.stamp_ns) <= MAX_EVENTS, 'the history of an object is too long')
    require(within(state.stamp_ns, 0, END_STAMP_NS), 'a time stamp is out of range')
    require((np.diff(state.stamp_ns) >= 0).all(), 'the history of an object is not sorted')
    kinds = [kind.value for kind in EventKind]
    require(np.isin(state.kind, kinds).all(), 'an event of an object is unknown')
    require(within(state.person_id, -1, MAX_COUNT), 'the person of an event is invalid')
    require(within(state.distance_m, 0, MAX_POSITION_M), 'the distance of an event is invalid')
    require(within(state.color_px, 0, MAX_COUNT), 'a number of colored pixels is invalid')
    require(within(state.picture_ns, 0, END_STAMP_NS), 'a time stamp is out of range')
    require(within(state.picture_rank, 0, MAX_WEIGHT), 'the rank of a picture is invalid')
    require(len(state.jpeg) <= MAX_JPEG_BYTES, 'a picture has too many bytes')
    jpeg = state.jpeg.tobytes()
    size_px = image_size_px(jpeg) if is_jpeg(jpeg) and is_safe_to_decode(jpeg) else None
    is_small = size_px is not None and all(0 < side <= MAX_SIDE_PX for side in size_px)
    require(is_small or not jpeg, 'a picture is no small JPEG')
