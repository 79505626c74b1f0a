"""The images of the dense map, kept in another process as well: it outlives the one that fuses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count
from typing import NamedTuple

from hoid_common.values import FloatArray
from rgbd_slam.scene.dense_mapper import StoredView
from rgbd_slam.scene.dense_state import doubled, halved
from rgbd_slam.scene.voxel_map import DepthView


class ViewChange(NamedTuple):
    """What became of one image: new, hung on another keyframe, or gone."""

    slot: int  # its number
    hung: tuple[int, FloatArray] | None  # keyframe's uid and T_keyframe_camera (4, 4); None: gone
    image: DepthView | None = None  # when new; its colour has half the resolution of its depth


class ViewLedger:
    """Says what changed among the images that a dense map keeps."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[int, StoredView]] = {}  # slot and view, by the image's id
        self._slots = count()

    def adopt(self, slot: int, view: StoredView) -> None:
        """Know an image by the number that it had in the process before this one."""
        self._known[id(view.view)] = slot, view
        self._slots = count(max(slot + 1, next(self._slots)))

    def changes(self, views: Sequence[StoredView]) -> Iterator[ViewChange]:
        """Yield what is new since the last call, by the images that are kept now."""
        gone, self._known = self._known, {}
        for view in views:
            slot, before = gone.pop(id(view.view), (None, None))
            hung = view.keyframe_uid, view.T_keyframe_camera
            if slot is None:
                slot = next(self._slots)
                small = halved(view.view.image_bgr)
                yield ViewChange(slot, hung, DepthView(view.view.flagged_mm, small))
            elif before is None or before.T_keyframe_camera is not view.T_keyframe_camera:
                yield ViewChange(slot, hung)
            self._known[id(view.view)] = slot, view
        for slot, _ in gone.values():
            yield ViewChange(slot, None)


class ViewCopies:
    """The images as the last change has left them, about 0.2 MB each."""

    def __init__(self) -> None:
        self._copies: dict[int, StoredView] = {}

    def __len__(self) -> int:
        return len(self._copies)

    def apply(self, change: ViewChange) -> None:
        """Take a change over; one of an image that is not known, as after `clear`, is none."""
        if change.hung is None:
            self._copies.pop(change.slot, None)
            return
        before = self._copies.get(change.slot)
        image = change.image or (before.view if before is not None else None)
        if image is not None:
            self._copies[change.slot] = StoredView(image, *change.hung)

    def clear(self) -> None:
        """Forget all."""
        self._copies.clear()

    def small(self) -> list[StoredView]:
        """Return the images, their colour at half the resolution of depth."""
        return list(self._copies.values())

    def views(self) -> list[tuple[int, StoredView]]:
        """Return the images with their numbers, colour at the resolution of depth again."""
        return [(slot, _whole(copy)) for slot, copy in list(self._copies.items())]


def _whole(copy: StoredView) -> StoredView:
    rows, columns = copy.view.flagged_mm.shape
    image_bgr = doubled(copy.view.image_bgr)[:rows, :columns]
    whole = DepthView(copy.view.flagged_mm, image_bgr)
    return StoredView(whole, copy.keyframe_uid, copy.T_keyframe_camera)
