"""Segments the surfaces of objects from the depth inside their boxes.

The box of an object also shows what the object stands on or leans against, and what hides a part
of it. `hoid_native.object_surfaces` removes the former as planes that continue around the box, and
the latter where its surface fits the box of another object better, or where the place of the
object is known. Other things in the box are left out if a depth edge separates them from the
object and their surface continues beyond the box.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.values import PERSON, BoolArray, DynamicObject, Float32Array, FloatArray, IntArray
from hoid_native import object_surfaces
from hoid_scene.objects.object_view import ObjectView, edge_m

# Not tuned: a part of a segment continues beyond its box if it has at least so many pixels, and at
# least this ratio of its pixels in the box, in the outer ring of a margin around the box: detected
# boxes are a few pixels off.
_MARGIN_PX, _INNER_MARGIN_PX, _MIN_BEYOND, _BEYOND_RATIO = 4, 1, 6, 0.1

# Classes without planar parts: a plane that continues around the box is the wall or the floor
# behind legs and leaves. Chosen.
_NEVER_FLAT = frozenset({'chair', 'potted plant'})

# Classes on which no other things lie: a detection on them is a part of them, such as the foot of
# a monitor that a detector calls a phone. Chosen.
BARE = frozenset(
    {
        'tv', 'laptop', 'keyboard', 'mouse', 'remote', 'cell phone', 'potted plant', 'vase', 'cup',
        'bottle', 'wine glass', 'clock', 'teddy bear', 'umbrella', 'bicycle', 'backpack',
    }
)  # fmt: skip
# Surface in the box of such a class is more often a thing behind it than on it. Chosen.
_SEATS = frozenset({'chair'})

BoxPx = tuple[int, int, int, int]
"""Left, top, right and bottom in strided pixels; right and bottom are excluded."""


class KnownBox(NamedTuple):
    """The box of a known object, enlarged by as much as it may grow in one image."""

    T_box_map: FloatArray  # (4, 4) transform from the map frame to the object frame
    low_m: FloatArray  # (3,) lowest corner in the object frame
    high_m: FloatArray  # (3,) highest corner in the object frame


class Prior(NamedTuple):
    """The knowledge of the map about an image before its boxes are segmented."""

    # (h * w,) by strided pixel: index of the detection of the object that the map has there; -1:
    # none.
    owner: NDArray[np.int32]
    known: Mapping[int, KnownBox]  # by the index of the detection: known box of its object


class Segment(NamedTuple):
    """The surface of one detected object."""

    detection: DynamicObject
    box_px: BoxPx
    pixels: IntArray  # (M,) flat indices of the strided pixels that show the object
    points_map_m: FloatArray  # (M, 3) points of these pixels
    center_map_m: FloatArray  # (3,) medians of the points along each axis
    low_map_m: FloatArray  # (3,) lowest corner of their bounding box
    high_map_m: FloatArray  # (3,) highest corner
    others: IntArray  # (N,) flat indices of the pixels in the box that show other things
    is_cut: bool = False  # whether the box reaches the border of the image

    def radius_m(self) -> float:
        """Return half the diagonal [m] of the points' bounding box, along the map's axes."""
        return float(np.linalg.norm(self.high_map_m - self.low_map_m) / 2)


def segment_all(
    detections: Sequence[DynamicObject], view: ObjectView, prior: Prior
) -> list[Segment]:
    """Return the segments of detected objects, except people, that have enough depth readings.

    Surface in two boxes belongs to the box that it fills better, or to the smaller box if it fills
    both. The other object is segmented again from the remaining pixels, and left out if they are
    too few; a person keeps its pixels.
    """
    boxes = [view.pixels_of(item.box_xyxy_px) for item in detections]
    sides = np.array([item.box_xyxy_px for item in detections], np.float64).reshape(-1, 4)
    T_box_map, low_m, high_m = _known_boxes(prior.known, len(detections))
    found = object_surfaces(
        view.depth_m,
        view.points_map_m,
        view.pixel_m,
        np.array(boxes, np.int32).reshape(-1, 4),
        (sides[:, 2:] - sides[:, :2]).prod(axis=1),
        np.array([item.class_name == PERSON for item in detections], np.bool_),
        np.array([item.class_name not in BARE | _SEATS for item in detections], np.bool_),
        np.array([item.class_name not in _NEVER_FLAT for item in detections], np.bool_),
        T_box_map,
        low_m,
        high_m,
        prior.owner,
    )
    out = []
    first = first_other = 0
    ends = zip(found.pixels_end.tolist(), found.others_end.tolist(), strict=True)
    for d, (end, end_other) in zip(found.detection.tolist(), ends, strict=True):
        pixels = found.pixels[first:end]
        is_own = _is_own(pixels, boxes[d], view)
        points_m = found.points_map_m[first:end][is_own]
        others = np.union1d(found.others[first_other:end_other], pixels[~is_own])
        out.append(
            Segment(
                detections[d],
                boxes[d],
                pixels[is_own],
                points_m,
                np.median(points_m, axis=0),
                points_m.min(axis=0),
                points_m.max(axis=0),
                others,
                view.is_at_border(boxes[d]),
            )
        )
        first, first_other = end, end_other
    return out


def _is_own(pixels: IntArray, box_px: BoxPx, view: ObjectView) -> BoolArray:
    """Return the (M,) mask of the pixels of a segment that show the object.

    Depth edges divide the segment into parts. The largest part is of the object, and so are the
    other parts unless their surface continues beyond the box.
    """
    height, width = view.shape
    left, top = (max(n - _MARGIN_PX, 0) for n in box_px[:2])
    right, bottom = min(box_px[2] + _MARGIN_PX, width), min(box_px[3] + _MARGIN_PX, height)
    depth_m = view.depth_m[top:bottom, left:right]
    v, u = np.divmod(pixels, width)
    u, v = u - left, v - top
    is_used = depth_m > 0
    is_beyond = is_used.copy()
    for each, spare in ((is_used, 0), (is_beyond, _INNER_MARGIN_PX)):
        rows = slice(max(box_px[1] - spare - top, 0), box_px[3] + spare - top)
        each[rows, max(box_px[0] - spare - left, 0) : box_px[2] + spare - left] = False
    is_used[v, u] = True
    labels = _parts(depth_m, is_used)
    inside = np.bincount(labels[v, u], minlength=int(labels.max()) + 1)
    beyond = np.bincount(labels[is_beyond], minlength=len(inside))
    goes_on = beyond >= np.maximum(_MIN_BEYOND, _BEYOND_RATIO * inside)
    goes_on[np.argmax(inside)] = False
    return np.asarray(~goes_on[labels[v, u]])


def _parts(depth_m: Float32Array, is_used: BoolArray) -> NDArray[np.int32]:
    """Return the (h, w) numbers of the parts of used pixels that no depth edge divides."""
    links = np.zeros((2 * depth_m.shape[0] - 1, 2 * depth_m.shape[1] - 1), np.uint8)
    links[::2, ::2] = is_used
    limit_m = edge_m(depth_m)
    is_level = np.abs(depth_m[:, 1:] - depth_m[:, :-1]) < limit_m[:, 1:]
    links[::2, 1::2] = is_level & is_used[:, 1:] & is_used[:, :-1]
    is_level = np.abs(depth_m[1:] - depth_m[:-1]) < limit_m[1:]
    links[1::2, ::2] = is_level & is_used[1:] & is_used[:-1]
    _, labels = cv2.connectedComponents(links, connectivity=4)
    return np.asarray(labels[::2, ::2])


def _known_boxes(
    known: Mapping[int, KnownBox], num: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (num, 4, 4) transforms T_box_map and the lowest and highest corners (num, 3).

    The lowest corner of an unknown box is above the highest one.
    """
    T_box_map = np.zeros((num, 4, 4))
    low_m, high_m = np.ones((num, 3)), np.zeros((num, 3))
    for d, box in known.items():  # fast enough for few boxes
        T_box_map[d], low_m[d], high_m[d] = box
    return T_box_map, low_m, high_m
