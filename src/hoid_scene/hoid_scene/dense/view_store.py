"""Database of the images from which the dense map is made, each relative to a keyframe."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.io.records import Record, column
from hoid_common.store.database import SUFFIX, Database
from hoid_common.store.table import Table
from hoid_common.values import ByteArray, FloatArray
from hoid_scene.dense.depth_view import DepthView


@dataclass(frozen=True, eq=False)
class Pose(Record):
    """A rigid transform."""

    T: Annotated[FloatArray, column('f8', 4, 4)]


@dataclass(frozen=True, eq=False)
class ViewImage(Record):
    """The image of a `DepthView`; 0.2 MB for 640x480 px."""

    flagged_mm: Annotated[NDArray[np.uint16], column('u2', 'rows', 'columns')]
    image_bgr: Annotated[ByteArray, column('u1', 'half_rows', 'half_columns', 3)]


# Two tables, because a new anchor keyframe changes the pose of a view, but not its image.
VIEWS = Table('scene_views', 'slot', {'keyframe_uid': int, 'pose': Pose})
IMAGES = Table('scene_images', 'slot', {'image': ViewImage})


class StoredView(NamedTuple):
    """The pose of a stored image relative to its keyframe."""

    keyframe_uid: int
    T_keyframe_camera: FloatArray  # (4, 4)


class ViewStore:
    """Stores the images of the dense map in a database, by number (slot).

    Its methods raise MapFileError if the database cannot be read or written.

    Args:
        database: Has the tables `VIEWS` and `IMAGES`.
    """

    def __init__(self, database: Database) -> None:
        self._database = database

    @classmethod
    def temporary(cls) -> ViewStore:
        with TemporaryDirectory() as folder:
            return cls(Database.create(Path(folder) / f'views{SUFFIX}', (VIEWS, IMAGES)))

    def views(self) -> Iterator[tuple[int, StoredView]]:
        for slot, uid, pose in self._database.rows(VIEWS):
            yield slot, StoredView(uid, pose.T)

    def read(self, slot: int) -> DepthView:
        row = self._database.row(IMAGES, slot)
        assert row is not None
        return DepthView(row[1].flagged_mm, row[1].image_bgr)

    def put(self, slot: int, view: StoredView, image: DepthView) -> None:
        self._database.put(IMAGES, [(slot, ViewImage(image.flagged_mm, image.image_bgr))])
        self.attach(slot, view)

    def attach(self, slot: int, view: StoredView) -> None:
        self._database.put(VIEWS, [(slot, view.keyframe_uid, Pose(view.T_keyframe_camera))])

    def discard(self, slot: int) -> None:
        for table in (VIEWS, IMAGES):
            self._database.delete(table, [slot])
