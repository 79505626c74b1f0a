"""The dense map in a map file: the stored images from which it can be built again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import ByteArray, CameraModel, FloatArray, IntArray
from rgbd_slam.records.record import Array, Record, column
from rgbd_slam.scene.stored_view import StoredView, doubled, halved
from rgbd_slam.scene.voxel_map import DepthView


@dataclass(frozen=True, eq=False)
class DenseState(Record):
    """V stored images. Color has half the resolution of depth: a voxel averages many pixels."""

    keyframe: Annotated[NDArray[np.int32], column('i4', 'views')]  # row in the saved map
    T_keyframe_camera: Annotated[FloatArray, column('f8', 'views', 4, 4)]
    # The depth as in `DepthView`.
    flagged_mm: Annotated[NDArray[np.uint16], column('u2', 'views', 'rows', 'columns')]
    image_bgr: Annotated[ByteArray, column('u1', 'views', 'half_rows', 'half_columns', 3)]

    def __len__(self) -> int:
        return len(self.keyframe)

    @classmethod
    def of_views(
        cls, views: Sequence[StoredView], keyframe_uids: IntArray, *, is_halved: bool = False
    ) -> DenseState:
        """Return the record of stored images, without those of other keyframes.

        Args:
            views: The images, at least one.
            keyframe_uids: (K,) ascending uids of the saved keyframes.
            is_halved: Whether color has half the resolution of depth already.
        """
        kept = [view for view in views if view.keyframe_uid in set(keyframe_uids.tolist())]
        rows, columns = views[0].view.flagged_mm.shape
        colors = [v.view.image_bgr if is_halved else halved(v.view.image_bgr) for v in kept]
        half = colors[0].shape if colors else ((rows + 1) // 2, (columns + 1) // 2, 3)
        uids = np.array([view.keyframe_uid for view in kept], np.int64)
        return cls.of(
            {
                'keyframe': np.searchsorted(keyframe_uids, uids),
                'T_keyframe_camera': _stacked([v.T_keyframe_camera for v in kept], (4, 4)),
                'flagged_mm': _stacked([v.view.flagged_mm for v in kept], (rows, columns)),
                'image_bgr': _stacked(colors, half),
            }
        )

    def fits(self, camera: CameraModel, pixel_stride: int) -> bool:
        """Return whether the images have the size that the dense map uses."""
        size = camera.height_px, camera.width_px
        return self.flagged_mm.shape[1:] == tuple(-(-n // pixel_stride) for n in size)

    def views(self, keyframe_uids: IntArray) -> list[StoredView]:
        """Return the stored images, none of which is integrated yet.

        Args:
            keyframe_uids: (K,) uids that the keyframes of the saved map have now.
        """
        columns = self.flagged_mm, self.image_bgr, keyframe_uids[self.keyframe]
        return [
            StoredView(DepthView(flagged_mm, doubled(image, flagged_mm.shape)), int(uid), T)
            for flagged_mm, image, uid, T in zip(*columns, self.T_keyframe_camera, strict=True)
        ]


def _stacked(arrays: Sequence[Array], shape: tuple[int, ...]) -> Array:
    return np.array(arrays).reshape(-1, *shape)
