"""What a strategy looks at and what it answers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from hoid_common.values import (
    PERSON,
    BoolArray,
    ByteArray,
    Detections,
    Float32Array,
    FloatArray,
    IntArray,
    Reason,
)
from hoid_native import sample_depths_m


@dataclass(frozen=True, eq=False)
class View:
    """One image as a strategy gets it."""

    stamp_ns: int
    heard: Detections | None  # clipped; of this image or an older one; None: nothing was said
    depth_m: Float32Array  # (H, W); 0 = no reading
    corner_pixels: IntArray  # (K,) of the corners found, as indices in the flat image


@dataclass(frozen=True, eq=False)
class Scene:
    """One image with the boxes brought to its stamp."""

    detections: Detections  # at the image's stamp, inside the image
    detected: bool  # False: the boxes are predicted, the detector said nothing about this image
    depth_m: Float32Array  # (H, W); 0 = no reading
    corner_pixels: IntArray  # (K,) of the corners found, as indices in the flat image
    sample_box_px: int  # side of the box at the centre of each detection where depth is read

    @cached_property
    def is_person(self) -> BoolArray:
        """Return the (N,) flags of the detections that are people."""
        names = self.detections.class_names
        return np.fromiter((name == PERSON for name in names), np.bool_, len(names))

    @cached_property
    def depths_m(self) -> FloatArray:
        """Return the (N,) depths of the detections at their sample boxes; NaN = unknown."""
        boxes = self.detections.boxes_xyxy_px
        return sample_depths_m(self.depth_m, boxes, self.sample_box_px)


@dataclass(frozen=True, eq=False)
class Verdict:
    """Which objects are dynamic and which pixels may not be used. All arrays in the same order."""

    boxes_xyxy_px: Float32Array  # (N, 4)
    class_names: tuple[str, ...]  # N
    scores: Float32Array  # (N,)
    track_ids: IntArray  # (N,); -1 = not tracked
    reasons: tuple[Reason, ...]  # N
    overlap_ratios: FloatArray  # (N,), in [0, 1]
    depths_m: FloatArray  # (N,); NaN = unknown
    depth_gaps_m: FloatArray  # (N,), to the person who overlaps; NaN = unknown
    keep_mask: ByteArray | None  # (H, W), 0 = dynamic; None = the whole image is static
    seed_mask: ByteArray | None = None  # (H, W), 0 = no map seeds; None = wherever features are
    fallback_step: int = 0  # how far the mask was relaxed for lack of static features


class Strategy(Protocol):
    """Tells which objects are dynamic."""

    def judge(self, view: View) -> Verdict:
        """Return the verdict on one image; images come in order of time."""


def box_mask(boxes_xyxy_px: FloatArray | Float32Array, height: int, width: int) -> ByteArray:
    """Return (height, width) uint8: 0 at the pixels whose centre is in a box, 255 elsewhere."""
    mask = np.full((height, width), 255, np.uint8)
    for x1, y1, x2, y2 in np.ceil(np.maximum(boxes_xyxy_px, 0)).astype(int).tolist():
        mask[y1:y2, x1:x2] = 0
    return mask
