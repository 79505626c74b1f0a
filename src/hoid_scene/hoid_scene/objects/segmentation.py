"""Segments the surfaces of objects from the depth readings inside their boxes.

The box of an object also shows what the object stands on or leans against, and what hides a part
of it. `hoid_native.object_surfaces` removes the former as planes that continue around the box, and
the latter where its surface fits the box of another object better, or where the place of the
object is known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import PERSON, DynamicObject, FloatArray, IntArray
from hoid_native import object_surfaces
from hoid_scene.objects.object_view import ObjectView

BoxPx = tuple[int, int, int, int]
"""Left, top, right and bottom in strided pixels; right and bottom are excluded."""


class KnownBox(NamedTuple):
    """The box of a known object, enlarged by as much as it may grow in one image."""

    T_box_map: FloatArray  # (4, 4) transform from the map frame to the object frame
    low_m: FloatArray  # (3,) lowest corner in the object frame
    high_m: FloatArray  # (3,) highest corner in the object frame


class Prior(NamedTuple):
    """What is known from the map about an image before the boxes in it are segmented."""

    # (h * w,) by strided pixel: index of the detection of the object that the map has there; -1:
    # none.
    owner: NDArray[np.int32]
    known: Mapping[int, KnownBox]  # by the index of the detection: known box of its object


class Segment(NamedTuple):
    """The surface of one detected object."""

    detection: DynamicObject
    box_px: BoxPx
    pixels: IntArray  # (M,) flat indices of the strided pixels that show the object
    points_map_m: FloatArray  # (M, 3) of these
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
    """Return the segments of the detected objects that have enough readings, without people.

    Where two boxes claim the same surface, it belongs to the box that it fills better, or of two
    boxes that are filled to the smaller one. The other object is segmented again from the
    remaining pixels, and left out if they are too few; a person keeps its pixels.

    Args:
        detections: The detections.
        view: The image.
        prior: What the map knows of the objects.
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
        T_box_map,
        low_m,
        high_m,
        prior.owner,
    )
    out = []
    first = first_other = 0
    ends = zip(found.pixels_end.tolist(), found.others_end.tolist(), strict=True)
    for s, (d, (end, end_other)) in enumerate(zip(found.detection.tolist(), ends, strict=True)):
        out.append(
            Segment(
                detections[d],
                boxes[d],
                found.pixels[first:end],
                found.points_map_m[first:end],
                found.center_map_m[s],
                found.low_map_m[s],
                found.high_map_m[s],
                found.others[first_other:end_other],
                view.is_at_border(boxes[d]),
            )
        )
        first, first_other = end, end_other
    return out


def _known_boxes(
    known: Mapping[int, KnownBox], num: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (num, 4, 4) transforms T_box_map and the lowest and highest corners (num, 3).

    The lowest corner of an unknown box is above the highest one.
    """
    T_box_map = np.zeros((num, 4, 4))
    low_m, high_m = np.ones((num, 3)), np.zeros((num, 3))
    for d, box in known.items():  # a handful
        T_box_map[d], low_m[d], high_m[d] = box
    return T_box_map, low_m, high_m
