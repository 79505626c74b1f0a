"""Associates the segments of one image with the objects of the map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, Detections, DynamicObject, FloatArray, IntArray
from hoid_native import missed_voxels, pair_scores, transformed_parts
from hoid_scene.objects.evidence import is_confusable
from hoid_scene.objects.mapped_object import MappedObject
from hoid_scene.objects.object_view import STRIDE, ObjectView
from hoid_scene.objects.segmentation import KnownBox, Prior, Segment

# Smallest score of an associated pair: of the same class, of classes that detectors confuse, and
# of other classes. From a trial on six rendered rooms, before this code was written.
_SAME, _CONFUSABLE, _OTHER = 0.35, 0.5, 0.6
# From this ratio of radii on, segment and object do not match if detectors do not confuse their
# classes: a table is not the screen on it. Chosen; on `fr1_xyz`, a screen grew over the table on
# which it stands.
_SIZE_RATIO = 1.6
_MARGIN_M = 0.04  # by which an object's box is enlarged on each side; not tuned
# Smallest intersection over union of a detected box and the bounding box of an object's visible
# voxels with which the box shows this object; not tuned.
_OWN_OVERLAP = 0.3
_LAST_PIXEL = np.array([0, 0, 1, 1])  # added because a box of pixels ends after its last pixel
# Share of a detected box's size by which, in addition to one strided pixel, its sides are
# uncertain; not tuned.
_MISS_MARGIN = 0.05
# Smallest ratio of an object's surface that must be visible before the object is expected in an
# image; not tuned.
_EXPECTED_RATIO = 0.5


class Visibility(NamedTuple):
    """Visibility of the N voxels of one object in one image."""

    uv_px: FloatArray  # (N, 2) in strided pixels; NaN: out of view
    is_visible: BoolArray  # (N,) whether a surface is measured at the voxel
    visible_ratio: float  # share of the solid voxels that are visible; 0 if there are none
    through_ratio: float  # share of the solid voxels that are seen through; 0 if there are none
    # (4,) bounding box of the visible solid voxels in strided pixels, xyxy; NaN if there are none.
    box_px: FloatArray


def look_at(objects: Sequence[MappedObject], view: ObjectView) -> list[Visibility]:
    if not objects:
        return []
    means_m = np.concatenate([item.surface.voxels.means_m for item in objects])
    ends = np.cumsum([len(item.surface.voxels) for item in objects])
    poses = np.array([item.surface.T_map_object for item in objects])
    seen = view.look_at(
        transformed_parts(means_m, ends, se3.inverse(view.T_map_camera) @ poses),
        np.concatenate([item.surface.is_solid() for item in objects]),
        ends,
    )
    shares = (seen.counts[:, 1:] / np.maximum(seen.counts[:, :1], 1)).tolist()
    starts = [0, *ends.tolist()]
    return [
        Visibility(seen.uv_px[a:b], seen.is_visible[a:b], visible, through, box_px)
        for a, b, (visible, through), box_px in zip(
            starts, starts[1:], shares, seen.boxes_px, strict=False
        )
    ]


def prior_of(
    detections: Sequence[DynamicObject],
    objects: Sequence[MappedObject],
    seen: Sequence[Visibility],
    view: ObjectView,
) -> Prior:
    """Return which detections show confirmed objects of the map, and the pixels of these objects.

    A confirmed object is shown by the detection of its class whose box overlaps the bounding box
    of its visible voxels most, with an intersection over union of 0.3 or more. The pixels of its
    known surface are then not given to the segment of an object behind it, and a surface that
    hides it is not assigned to it.
    """
    owner = np.full(view.depth_m.size, -1, np.int32)
    known: dict[int, tuple[float, KnownBox]] = {}
    boxes = np.array([view.pixels_of(item.box_xyxy_px) for item in detections]).reshape(-1, 4)
    by_class: dict[str, list[int]] = {}
    for d, detection in enumerate(detections):
        by_class.setdefault(detection.class_name, []).append(d)
    for item, visibility in zip(objects, seen, strict=True):  # fast enough for some tens
        alike = by_class.get(item.class_name)
        if alike is None or not item.is_confirmed:
            continue
        if visibility.visible_ratio == 0:
            continue
        overlap = _overlap(visibility.box_px + _LAST_PIXEL, boxes[alike])
        best = int(np.argmax(overlap))
        if overlap[best] >= _OWN_OVERLAP:
            d = alike[best]
            u1, v1, u2, v2 = visibility.box_px.tolist()
            box = math.floor(u1), math.floor(v1), math.ceil(u2) + 1, math.ceil(v2) + 1
            owner[item.surface.pixels(view, box)] = d
            if d not in known or overlap[best] > known[d][0]:
                known[d] = float(overlap[best]), item.surface.known_box()
    return Prior(owner, {d: box for d, (_, box) in known.items()})


def _overlap(box_px: FloatArray, boxes_px: IntArray) -> FloatArray:
    """Return the intersection over union (N,) of a box (4,) with boxes (N, 4), all xyxy."""
    low = np.maximum(box_px[:2], boxes_px[:, :2])
    shared = np.maximum(np.minimum(box_px[2:], boxes_px[:, 2:]) - low, 0).prod(axis=1)
    areas = (boxes_px[:, 2:] - boxes_px[:, :2]).prod(axis=1)
    return np.asarray(shared / np.maximum((box_px[2:] - box_px[:2]).prod() + areas - shared, 1))


def associate(
    segments: Sequence[Segment], objects: Sequence[MappedObject], seen: Sequence[Visibility]
) -> dict[int, int]:
    """Return which object each segment shows: index of the object by index of the segment.

    The score of a pair is the geometric mean of two ratios: of the segment's points that are in
    the box of the object, and of the object's visible voxels that are in the box of the detection.
    Pairs are chosen from the largest score down, so that each segment and each object is in at
    most one pair. Pairs below the smallest score for their classes are left out.
    """
    if not segments or not objects:
        return {}
    score = _scores(segments, objects, seen)
    out: dict[int, int] = {}
    while score.max() > 0:
        s, o = (int(i) for i in np.unravel_index(int(np.argmax(score)), score.shape))
        out[s] = o
        score[s], score[:, o] = 0, 0
    return out


def _scores(
    segments: Sequence[Segment], objects: Sequence[MappedObject], seen: Sequence[Visibility]
) -> FloatArray:
    """Return the (S, O) scores of all pairs; 0 below the smallest score for their classes."""
    boxes_m = np.array([item.surface.box_m() for item in objects])
    score = pair_scores(
        np.concatenate([segment.points_map_m for segment in segments]),
        np.cumsum([len(segment.pixels) for segment in segments]),
        np.array([segment.box_px for segment in segments], np.int32),
        np.array([item.surface.place.T_place_map for item in objects]),
        boxes_m[:, 0] - _MARGIN_M,
        boxes_m[:, 1] + _MARGIN_M,
        np.concatenate([visibility.uv_px for visibility in seen]),
        np.concatenate([visibility.is_visible for visibility in seen]),
        np.cumsum([len(visibility.uv_px) for visibility in seen]),
        _may_touch(segments, objects),
    )
    for s, o in np.argwhere(score > 0).tolist():  # fast enough for some tens
        name, item = segments[s].detection.class_name, objects[o]
        small, large = sorted((segments[s].radius_m(), item.surface.radius_m()))
        is_other_size = large > _SIZE_RATIO * small and not is_confusable(name, item.class_name)
        if is_other_size or score[s, o] < _least(name, item):
            score[s, o] = 0
    return score


def _may_touch(segments: Sequence[Segment], objects: Sequence[MappedObject]) -> BoolArray:
    """Return the (S, O) mask of the segments and objects whose bounding spheres touch.

    Other pairs have no points in common.
    """
    low = np.array([segment.low_map_m for segment in segments])
    high = np.array([segment.high_map_m for segment in segments])
    centers = np.array([item.surface.center_map_m() for item in objects])
    radii = np.array([item.surface.radius_m() for item in objects]) + np.sqrt(3) * _MARGIN_M
    radii = radii + np.linalg.norm(high - low, axis=1)[:, None] / 2
    return np.asarray(np.linalg.norm((low + high)[:, None] / 2 - centers, axis=2) <= radii)


def expected_boxes(
    objects: Sequence[MappedObject], seen: Sequence[Visibility], stamp_ns: int
) -> Detections:
    """Return the expected boxes of known objects in an image; scores are probabilities.

    Only confirmed objects at rest with at least half of the surface visible are returned. A box
    bounds the visible voxels.
    """
    names, boxes, scores = [], [], []
    for item, visibility in zip(objects, seen, strict=True):  # fast enough for some tens
        is_known = item.is_confirmed and item.is_present
        if is_known and visibility.visible_ratio >= _EXPECTED_RATIO:
            names.append(item.class_name)
            boxes.append((visibility.box_px + _LAST_PIXEL) * STRIDE)
            scores.append(item.evidence.probability)
    boxes_xyxy_px = np.array(boxes, np.float32).reshape(-1, 4)
    return Detections(stamp_ns, boxes_xyxy_px, tuple(names), np.array(scores, np.float32))


def in_box(uv_px: FloatArray, box_px: tuple[int, int, int, int]) -> BoolArray:
    """Return the (N,) mask of the strided pixels (N, 2) that are in a box, end excluded."""
    left, top, right, bottom = box_px
    u, v = uv_px.T
    return np.asarray((u >= left - 0.5) & (u < right) & (v >= top - 0.5) & (v < bottom))


def missed_rows(segment: Segment, visibility: Visibility, view: ObjectView) -> IntArray:
    """Return the rows (M,) of visible voxels that a segment shows not to belong to its object."""
    left, top, right, bottom = segment.box_px
    du, dv = _MISS_MARGIN * (right - left) + 1, _MISS_MARGIN * (bottom - top) + 1
    box = np.array([left - du, top - dv, right + du, bottom + dv])
    width = view.shape[1]
    return missed_voxels(visibility.uv_px, visibility.is_visible, box, segment.others, width)


def _least(class_name: str, item: MappedObject) -> float:
    known = item.class_name
    if class_name == known:
        return _SAME
    return _CONFUSABLE if is_confusable(class_name, known) else _OTHER
