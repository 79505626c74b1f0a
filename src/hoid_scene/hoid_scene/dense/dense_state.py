"""The dense map in a map file: the stored images from which it can be built again."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hoid_common.io.records import Array, Record, column
from hoid_common.values import ByteArray, CameraModel, FloatArray, IntArray
from hoid_scene.dense.depth_view import DepthView
from hoid_scene.dense.stored_view import StoredView


@dataclass(frozen=True, eq=False)
class DenseState(Record):
    """V stored images. Color has half the resolution of depth, because a voxel averages pixels."""

    keyframe: Annotated[NDArray[np.int32], column('i4', 'views')]  # row in the saved map
    T_keyframe_camera: Annotated[FloatArray, column('f8', 'views', 4, 4)]
    # Depth [mm] with the flag of dynamic pixels in bit 15, as in `DepthView`.
    flagged_mm: Annotated[NDArray[np.uint16], column('u2', 'views', 'rows', 'columns')]
    image_bgr: Annotated[ByteArray, column('u1', 'views', 'half_rows', 'half_columns', 3)]

    def __len__(self) -> int:
        return len(self.keyframe)

    @classmethod
    def of_views(cls, views: Sequence[StoredView], keyframe_uids: IntArray) -> DenseState:
        """Return the record of the stored images whose keyframes are saved.

        Args:
            views: The images; those whose files have been removed are left out.
            keyframe_uids: (K,) ascending uids of the saved keyframes.
        """
        saved, kept, images = set(keyframe_uids.tolist()), [], []
        for view in views:
            with suppress(OSError):
                if view.keyframe_uid in saved:
                    images.append(view.read())
                    kept.append(view)
        shapes = [(i.flagged_mm.shape, i.image_bgr.shape) for i in images[:1]] or [((0, 0),) * 2]
        uids = np.array([view.keyframe_uid for view in kept], np.int64)
        return cls.of(
            {
                'keyframe': np.searchsorted(keyframe_uids, uids),
                'T_keyframe_camera': _stacked([v.T_keyframe_camera for v in kept], (4, 4)),
                'flagged_mm': _stacked([i.flagged_mm for i in images], shapes[0][0]),
                'image_bgr': _stacked([i.image_bgr for i in images], (*shapes[0][1][:2], 3)),
            }
        )

    def fits(self, camera: CameraModel, pixel_stride: int) -> bool:
        """Return whether the images have the size that a dense map with these settings uses.

        It is true without images.
        """
        size = camera.height_px, camera.width_px
        fitting = tuple(-(-n // pixel_stride) for n in size)
        return len(self) == 0 or self.flagged_mm.shape[1:] == fitting

    def views(self, keyframe_uids: IntArray) -> list[StoredView]:
        """Return the stored images, none of which is integrated yet.

        Args:
            keyframe_uids: (K,) present uids of the keyframes, in the order of the saved map.
        """
        columns = self.flagged_mm, self.image_bgr, keyframe_uids[self.keyframe]
        return [
            StoredView(DepthView(flagged_mm, image), int(uid), T)
            for flagged_mm, image, uid, T in zip(*columns, self.T_keyframe_camera, strict=True)
        ]


def _stacked(arrays: Sequence[Array], shape: tuple[int, ...]) -> Array:
    return np.array(arrays).reshape(len(arrays), *shape)
