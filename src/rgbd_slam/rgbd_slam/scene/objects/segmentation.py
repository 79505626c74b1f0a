"""Segments the surface of an object from the depth readings inside its box.

The box of an object also shows what the object stands on or leans against, and what hides a part
of it. The former is removed as planes that continue around the box; the latter is removed where
its surface fits the box of another object better, or where the place of the object is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import PERSON, BoolArray, DynamicObject, Float32Array, FloatArray, IntArray
from rgbd_slam.scene.objects.object_view import ObjectView, readings_in

# None of these numbers was tuned where no other source is named.
_MIN_READINGS = 6  # fewer readings do not show where an object is
# Width of the ring around a box: share of the box's longer side, and limits in strided pixels.
_RING_SHARE, _RING_PX = 0.25, (2, 10)
# Largest number of planes that are removed, and smallest share of the ring's readings on each.
_MAX_PLANES, _MIN_PLANE_SHARE = 3, 0.15
_TRIALS = 24  # number of planes through random points that are compared
_MAX_RING = 250  # readings of the ring that are used, to bound the time
# A reading at a depth z [m] belongs to a plane if its distance from it is less than
# _PLANE_M * max(1, _PLANE_GROWTH * z^2), because the noise of depth grows with z^2.
_PLANE_M, _PLANE_GROWTH = 0.015, 0.28
# An object keeps the readings near a plane if without them less than this share would remain: then
# it is flat itself, like a book on a table.
_MIN_REST = 0.15
# A layer is a range of depth that is at least 4 bins thick. The object begins at the nearest layer
# that has at least 0.6 times the readings of the fullest one (as in `object_sighting`).
_BIN_M, _LAYER_BINS, _NEARER_SHARE = 0.05, 4, 0.6
_LAYER_SHARE = 0.3  # a layer of a large object is as thick as this share of the size of its box
# An object ends at an empty range of depth of this length: share of the size of its box, at most
# so many meters.
_GAP_SHARE, _GAP_M = 0.3, 0.25
_EMPTY_SHARE = 0.02  # of the box's readings; a bin that has no more than this share is empty
# Largest extent of an object along the view: share of the size of its box, at least so many
# meters.
_MAX_DEPTH_SHARE, _MIN_DEPTH_M = 0.9, 0.2
# Two segments that share more than this part of the smaller one are the same surface; the second
# number holds if one of them is a person.
_SHARED, _SHARED_WITH_PERSON = 0.4, 0.1
# If at least this share of the object's nearest part is at its known place, nothing hides it.
_AT_PLACE_SHARE = 0.5
_SUPPORT_RATIO = 3.0  # ratio of box areas from which on the smaller object may lie on the larger
_FILLED = 0.6  # share of a box that its segment's bounding box must cover to fill it
_TINY = 1e-18  # avoids a division by zero
_RNG_SEED = 0


class KnownBox(NamedTuple):
    """The box of a known object, enlarged by as much as it may grow in one image."""

    T_box_map: FloatArray  # (4, 4) transform from the map frame to the object frame
    low_m: FloatArray  # (3,) lowest corner in the object frame
    high_m: FloatArray  # (3,) highest corner in the object frame

    def contains(self, points_map_m: FloatArray) -> BoolArray:
        """Return the (N,) mask of the points (N, 3) of the map frame that are in the box."""
        points = se3.transform(self.T_box_map, points_map_m)
        return np.asarray(((points > self.low_m) & (points < self.high_m)).all(axis=1))


class Prior(NamedTuple):
    """What is known from the map about an image before the boxes in it are segmented."""

    # (h * w,) by strided pixel: index of the detection of the object that the map has there; -1:
    # none.
    owner: IntArray
    known: dict[int, KnownBox]  # by the index of the detection: known box of its object


class Segment(NamedTuple):
    """The surface of one detected object."""

    detection: DynamicObject
    box_px: tuple[int, int, int, int]  # left, top, right, bottom in strided pixels
    pixels: IntArray  # (M,) flat indices of the strided pixels that show the object
    points_map_m: FloatArray  # (M, 3) of these
    others: IntArray  # (N,) flat indices of the pixels in the box that show other things
    known: KnownBox | None  # known box of the object; None: it was not known

    def radius_m(self) -> float:
        """Return half the diagonal [m] of the points' bounding box, along the map's axes."""
        return float(np.linalg.norm(np.ptp(self.points_map_m, axis=0)) / 2)


def segment_all(
    detections: Sequence[DynamicObject], view: ObjectView, prior: Prior
) -> list[Segment]:
    """Return the segments of the detected objects that have enough readings, without people.

    Where two boxes claim the same surface, it belongs to the box that it fills better, or of two
    boxes that are filled to the smaller one. The other object is segmented again from the
    remaining pixels, and left out if they are too few; a person keeps its pixels.

    Args:
        detections: The detections.
        view: The image.
        prior: What the map knows of the objects.
    """
    found = []
    for d, detection in enumerate(detections):
        taken = _taken(prior.owner, detections, d).reshape(view.shape)
        found.append(_segment(detection, view, taken, prior.known.get(d)))
    segments = [segment for segment in found if segment is not None]
    for loser, taken in _conflicts(segments, view):
        again = _segment(segments[loser].detection, view, taken, segments[loser].known)
        empty = segments[loser]._replace(
            pixels=np.empty(0, np.int64), points_map_m=np.empty((0, 3))
        )
        segments[loser] = empty if again is None else again
    return [s for s in segments if s.detection.class_name != PERSON and len(s.pixels)]


def _taken(owner: IntArray, detections: Sequence[DynamicObject], d: int) -> BoolArray:
    """Return the (h * w,) mask of the pixels that show the objects of other detections.

    Pixels of an object whose box is at least three times as large are not in the mask: the object
    of detection `d` may lie on it, and the surface below is removed as a plane.
    """
    boxes = np.array([item.box_xyxy_px for item in detections])
    areas = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    takes = areas < _SUPPORT_RATIO * areas[d]
    takes[d] = False
    return np.asarray((owner >= 0) & takes[owner])


def _conflicts(segments: list[Segment], view: ObjectView) -> list[tuple[int, BoolArray]]:
    """Return the segments that lose pixels to others, as indices with (h, w) masks of these."""
    taken: dict[int, BoolArray] = {}
    masks = [_mask(segment.pixels, view) for segment in segments]
    claims = [_claim(segment, view) for segment in segments]

    for i, first in enumerate(segments):  # a handful
        for j in range(i):
            shared = np.count_nonzero(masks[i] & masks[j])
            is_person = PERSON in (first.detection.class_name, segments[j].detection.class_name)
            least = _SHARED_WITH_PERSON if is_person else _SHARED
            if shared <= least * min(len(first.pixels), len(segments[j].pixels)):
                continue
            loser, winner = (i, j) if claims[i] < claims[j] else (j, i)
            if segments[loser].detection.class_name == PERSON:
                continue
            taken[loser] = taken.get(loser, np.zeros(view.shape, np.bool_)) | masks[winner]
    return list(taken.items())


def _mask(pixels: IntArray, view: ObjectView) -> BoolArray:
    out = np.zeros(view.shape, np.bool_)
    out.reshape(-1)[pixels] = True
    return out


def _claim(segment: Segment, view: ObjectView) -> tuple[bool, float]:
    """Return the sort key of a segment; the one with the larger key keeps the shared pixels.

    Boxes that are filled come before others, and the smaller box before the larger one. Among
    boxes that are not filled, the one that is filled more comes first.
    """
    left, top, right, bottom = segment.box_px
    fit = _fit(segment, view)
    is_filled = fit >= _FILLED
    return is_filled, -(right - left) * (bottom - top) if is_filled else fit


def _fit(segment: Segment, view: ObjectView) -> float:
    """Return the share of the detected box that the bounding box of its segment covers."""
    row, col = np.divmod(segment.pixels, view.shape[1])
    left, top, right, bottom = segment.box_px
    covered = (np.ptp(row) + 1) * (np.ptp(col) + 1)
    return float(covered / max((right - left) * (bottom - top), 1))


def _segment(
    detection: DynamicObject, view: ObjectView, taken: BoolArray, known: KnownBox | None
) -> Segment | None:
    """Return the segment of a detection, or None if it has too few readings.

    Args:
        detection: The detection.
        view: The image.
        taken: (h, w) mask of pixels that show other objects.
        known: Known box of the object; None: the map does not have the object.
    """
    box = view.pixels_of(detection.box_xyxy_px)
    pixels = everything = readings_in(view, *box)
    pixels = pixels[~taken.reshape(-1)[pixels]]
    if len(pixels) < _MIN_READINGS:
        return None
    if detection.class_name != PERSON:
        pixels = _without_planes(pixels, box, view)
    others = everything[~_members(everything, pixels, view)]
    pixels = _part(pixels, box, view, known)
    if len(pixels) < _MIN_READINGS:
        return None
    return Segment(detection, box, pixels, view.points_map_m[pixels], others, known)


def _members(pixels: IntArray, of: IntArray, view: ObjectView) -> BoolArray:
    """Return the (N,) mask of the pixels (N,) that are among the pixels `of` (M,)."""
    return np.asarray(_mask(of, view).reshape(-1)[pixels])


def _without_planes(
    pixels: IntArray, box: tuple[int, int, int, int], view: ObjectView
) -> IntArray:
    """Return the pixels (M,) among `pixels` (N,) that are not on a plane around the box.

    Those on a plane are kept if too few others would remain.
    """
    rest = pixels
    ring = _ring(box, view, pixels)
    depth = view.depth_m.reshape(-1)
    rng = np.random.default_rng(_RNG_SEED)
    num_ring = len(ring)
    for _ in range(_MAX_PLANES):
        if len(ring) < max(_MIN_READINGS, _MIN_PLANE_SHARE * num_ring):
            break
        normal, offset = _best_plane(view.points_map_m[ring], depth[ring], rng)
        on_ring = _is_on(view, ring, depth, normal, offset)
        if np.count_nonzero(on_ring) < max(_MIN_READINGS, _MIN_PLANE_SHARE * num_ring):
            break
        left = rest[~_is_on(view, rest, depth, normal, offset)]
        if len(left) >= max(_MIN_READINGS, _MIN_REST * len(pixels)):
            rest = left
        ring = ring[~on_ring]
    return rest


def _is_on(
    view: ObjectView, pixels: IntArray, depth: Float32Array, normal: FloatArray, offset: float
) -> BoolArray:
    distance = np.abs(view.points_map_m[pixels] @ normal - offset)
    return np.asarray(distance < _tolerance_m(depth[pixels]))


def _tolerance_m(depth_m: Float32Array) -> Float32Array:
    """Return the distances (N,) [m] within which readings belong to a plane.

    They grow with the square of the depth, as its noise does.
    """
    return np.asarray(_PLANE_M * np.maximum(1.0, _PLANE_GROWTH * depth_m**2), np.float32)


def _ring(box: tuple[int, int, int, int], view: ObjectView, inside: IntArray) -> IntArray:
    """Return pixels around a box that have about the range of depth of those inside it.

    Args:
        box: Left, top, right and bottom in strided pixels.
        view: The image.
        inside: (N,) pixels with readings inside the box.
    """
    left, top, right, bottom = box
    height, width = view.shape
    side = max(right - left, bottom - top)
    margin = int(np.clip(round(_RING_SHARE * side), *_RING_PX))
    outer = max(0, left - margin), max(0, top - margin)
    row, col = np.mgrid[
        outer[1] : min(height, bottom + margin), outer[0] : min(width, right + margin)
    ]
    pixels = (row * width + col)[(row < top) | (row >= bottom) | (col < left) | (col >= right)]
    depth = view.depth_m.reshape(-1)
    low, high = 0.9 * depth[inside].min(), 1.1 * depth[inside].max()
    kept = pixels[(depth[pixels] > low) & (depth[pixels] < high)]
    return np.asarray(kept[:: 1 + len(kept) // _MAX_RING], np.int64)


def _best_plane(
    points: FloatArray, depth: Float32Array, rng: np.random.Generator
) -> tuple[FloatArray, float]:
    """Return the plane with most points, refitted to them: unit normal (3,) and offset [m].

    Args:
        points: (N, 3) points of the map frame.
        depth: (N,) their depths.
        rng: Source of the random samples.
    """
    a, b, c = points[rng.integers(0, len(points), (3, _TRIALS))]
    (x1, y1, z1), (x2, y2, z2) = (b - a).T, (c - a).T
    normals = np.stack([y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2], axis=1)
    normals /= np.sqrt((normals * normals).sum(axis=1) + _TINY)[:, None]
    offsets = (normals * a).sum(axis=1)
    near = np.abs(points @ normals.T - offsets) < _tolerance_m(depth)[:, None]
    chosen = points[near[:, int(np.argmax(near.sum(axis=0)))]]
    center = chosen.mean(axis=0)
    normal = np.linalg.eigh((chosen - center).T @ (chosen - center))[1][:, 0]
    return normal, float(normal @ center)


def _part(
    pixels: IntArray, box: tuple[int, int, int, int], view: ObjectView, known: KnownBox | None
) -> IntArray:
    """Return the pixels of the object: its nearest part, or what is seen of it behind an occluder.

    The latter are the pixels in the known box, if less than half of them are in the nearest part.
    """
    nearest = _nearest_part(pixels, box, view)
    if known is None:
        return nearest
    at_place = pixels[known.contains(view.points_map_m[pixels])]
    if len(at_place) < _MIN_READINGS:
        return nearest
    is_nearest = _members(nearest, at_place, view).mean() >= _AT_PLACE_SHARE
    return nearest if is_nearest else at_place


def _nearest_part(pixels: IntArray, box: tuple[int, int, int, int], view: ObjectView) -> IntArray:
    """Return the pixels of the nearest well-filled layer, and behind it up to a gap in depth."""
    if len(pixels) == 0:
        return pixels
    depth = view.depth_m.reshape(-1)[pixels]
    bins = (depth / _BIN_M).astype(np.int64)
    count = np.bincount(bins, minlength=_LAYER_BINS)
    size_m = _size_m(box, view, float(np.median(depth)))
    thick = max(_LAYER_BINS, round(_LAYER_SHARE * size_m / _BIN_M))
    layers = np.convolve(count, np.ones(thick, np.int64))[thick - 1 :]
    if len(layers) == 0:
        layers = np.array([count.sum()])
    first = int(np.argmax(layers >= _NEARER_SHARE * layers.max()))
    first += int(np.argmax(count[first : first + thick] > 0))
    filled = count[first:] > max(1.0, _EMPTY_SHARE * len(pixels))
    filled[:thick] = True
    gap = max(2, round(min(_GAP_SHARE * size_m, _GAP_M) / _BIN_M))
    filled = np.pad(filled, (0, gap))
    gaps = np.convolve(filled, np.ones(gap, np.int64))[gap - 1 :] == 0
    most = round(max(_MAX_DEPTH_SHARE * size_m, _MIN_DEPTH_M) / _BIN_M)
    end = min(int(np.argmax(gaps)), most)
    # One bin before the layer: its first readings are noise of the same surface.
    return pixels[(bins >= first - 1) & (bins < first + end)]


def _size_m(box: tuple[int, int, int, int], view: ObjectView, depth_m: float) -> float:
    """Return the length [m] of the longer side of a box (in strided pixels) at a depth."""
    left, top, right, bottom = box
    return view.pixel_m * max(right - left, bottom - top) * depth_m
