"""The images that the scene is made of, each stored relative to a keyframe, and copies of them.

The scene process has the images; the SLAM node keeps copies, with which it saves the map and
restores the scene after the process has died.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.values import ByteArray, FloatArray
from rgbd_slam.scene.voxel_map import DepthView


@dataclass(frozen=True, eq=False)
class StoredView:
    """An image that is kept with its keyframe, so that it can be integrated again."""

    view: DepthView
    keyframe_uid: int
    T_keyframe_camera: FloatArray  # (4, 4)
    integrated_at: FloatArray | None = None  # (4, 4) T_map_camera; None: in no consumer now
    slot: int = -1  # its number in the ledger


class ViewChange(NamedTuple):
    """A stored view that is new, attached to another keyframe, or removed."""

    slot: int
    attached: tuple[int, FloatArray] | None  # keyframe's uid, T_keyframe_camera; None: removed
    image: DepthView | None = None  # of a new view, its color at half the resolution of its depth


class ViewCopies:
    """Copies of the stored views of another process, about 0.2 MB each."""

    def __init__(self) -> None:
        self._copies: dict[int, StoredView] = {}

    def apply(self, change: ViewChange) -> None:
        """Apply a change; ignore changes of unknown views, which arrive after `clear`."""
        if change.attached is None:
            self._copies.pop(change.slot, None)
            return
        before = self._copies.get(change.slot)
        image = change.image or (before.view if before is not None else None)
        if image is not None:
            self._copies[change.slot] = StoredView(image, *change.attached, slot=change.slot)

    def clear(self) -> None:
        """Discard all copies."""
        self._copies.clear()

    def with_half_color(self) -> list[StoredView]:
        """Return the views, with color at half the resolution of depth."""
        return list(self._copies.values())

    def with_full_color(self) -> list[StoredView]:
        """Return the views, with color scaled up to the resolution of depth."""
        return [_with_full_color(copy) for copy in list(self._copies.values())]


def halved(image_bgr: ByteArray) -> ByteArray:
    """Return an image (H, W, 3) at half the resolution, rounded up."""
    rows, columns = image_bgr.shape[:2]
    even = np.pad(image_bgr, ((0, rows % 2), (0, columns % 2), (0, 0)), 'edge')
    size = even.shape[1] // 2, even.shape[0] // 2
    return np.asarray(cv2.resize(even, size, interpolation=cv2.INTER_AREA), np.uint8)


def doubled(image_bgr: ByteArray, shape: tuple[int, ...]) -> ByteArray:
    """Return an image at twice the resolution, cropped to a shape (H, W)."""
    return image_bgr.repeat(2, axis=0).repeat(2, axis=1)[: shape[0], : shape[1]]


def _with_full_color(copy: StoredView) -> StoredView:
    flagged_mm, image_bgr = copy.view.flagged_mm, copy.view.image_bgr
    view = DepthView(flagged_mm, doubled(image_bgr, flagged_mm.shape))
    return StoredView(view, copy.keyframe_uid, copy.T_keyframe_camera, slot=copy.slot)
