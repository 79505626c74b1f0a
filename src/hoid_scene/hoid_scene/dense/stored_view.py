"""The images that the scene is made of, each stored in a file and relative to a keyframe.

The scene process writes the files. The SLAM node keeps a list of them, with which it restores the
scene after the scene process has died.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_common.values import FloatArray
from hoid_scene.dense.depth_view import DepthView


class ViewFile(NamedTuple):
    """A file with the usable readings and the color of one image (`DepthView`).

    Its size is 0.2 MB for 640x480 px, in proportion to the number of pixels.
    """

    path: Path

    @classmethod
    def write(cls, path: Path, view: DepthView) -> ViewFile:
        """Write an image to a file; raise OSError if it cannot be written."""
        with path.open('wb') as file:
            np.save(file, view.flagged_mm)
            np.save(file, view.image_bgr)
        return cls(path)

    def read(self) -> DepthView:
        """Read the image; raise OSError if the file has been removed."""
        with self.path.open('rb') as file:
            return DepthView(np.load(file), np.load(file))


@dataclass(frozen=True, eq=False)
class StoredView:
    """An image that is kept with its keyframe, so that it can be integrated again."""

    source: DepthView | ViewFile
    keyframe_uid: int
    T_keyframe_camera: FloatArray  # (4, 4)
    slot: int = -1  # its number in the ledger; -1: it is not in one yet

    def read(self) -> DepthView:
        """Return the image; raise OSError if its file has been removed."""
        return self.source.read() if isinstance(self.source, ViewFile) else self.source


class ViewChange(NamedTuple):
    """A stored view that is new or attached to another keyframe, or that was removed."""

    slot: int
    view: StoredView | None  # None: removed


class ViewList:
    """The stored views of another process, kept up to date by the changes that it reports."""

    def __init__(self) -> None:
        self._views: dict[int, StoredView] = {}

    def apply(self, change: ViewChange) -> None:
        """Store, replace or delete the view in the slot that a change names."""
        if change.view is None:
            self._views.pop(change.slot, None)
        else:
            self._views[change.slot] = change.view

    def clear(self) -> None:
        """Discard all views."""
        self._views.clear()

    def views(self) -> list[StoredView]:
        """Return the views, each once, by the order in which their slots were first reported."""
        return list(self._views.values())
