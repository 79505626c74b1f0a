"""The dense map as it is kept outside the running one: the images that it is fused of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.values import ByteArray, CameraModel, FloatArray, IntArray
from rgbd_slam.records.record import Array, Record, column
from rgbd_slam.scene.dense_mapper import StoredView
from rgbd_slam.scene.voxel_map import DepthView


@dataclass(frozen=True, eq=False)
class DenseState(Record):
    """Images (V). Colour has half the resolution of depth: a voxel takes many pixels anyway."""

    keyframe: Annotated[
        NDArray[np.int32], column('i4', 'views')
    ]  # row of the one that it hangs on
    T_keyframe_camera: Annotated[FloatArray, column('f8', 'views', 4, 4)]
    flagged_mm: Annotated[
        NDArray[np.uint16], column('u2', 'views', 'rows', 'columns')
    ]  # as in DepthView
    image_bgr: Annotated[ByteArray, column('u1', 'views', 'half_rows', 'half_columns', 3)]

    def __len__(self) -> int:
        return len(self.keyframe)

    @classmethod
    def of_views(
        cls, views: Sequence[StoredView], keyframe_uids: IntArray, *, is_halved: bool = False
    ) -> DenseState:
        """Return kept images; those that hang on none of the (K,) keyframes are left out.

        Args:
            views: The images, at least one.
            keyframe_uids: ascending; a view's keyframe is its place among them.
            is_halved: Whether colour has half the resolution already.
        """
        kept = [view for view in views if view.keyframe_uid in set(keyframe_uids.tolist())]
        rows, columns = views[0].view.flagged_mm.shape
        small = [v.view.image_bgr if is_halved else halved(v.view.image_bgr) for v in kept]
        half = small[0].shape if small else ((rows + 1) // 2, (columns + 1) // 2, 3)
        uids = np.array([view.keyframe_uid for view in kept], np.int64)
        return cls.of(
            {
                'keyframe': np.searchsorted(keyframe_uids, uids),
                'T_keyframe_camera': _stacked([v.T_keyframe_camera for v in kept], (4, 4)),
                'flagged_mm': _stacked([v.view.flagged_mm for v in kept], (rows, columns)),
                'image_bgr': _stacked(small, half),
            }
        )

    def fits(self, camera: CameraModel, pixel_stride: int) -> bool:
        """Return whether the images are of the size that the dense map takes."""
        whole = camera.height_px, camera.width_px
        return self.flagged_mm.shape[1:] == tuple(-(-n // pixel_stride) for n in whole)

    def views(self, keyframe_uids: IntArray) -> list[StoredView]:
        """Return the images to be kept, none of them fused yet.

        Args:
            keyframe_uids: (K,) of the keyframes of the map that was saved with them.
        """
        rows, columns = self.flagged_mm.shape[1:]
        return [
            StoredView(DepthView(flagged_mm, doubled(image)[:rows, :columns]), int(uid), T)
            for flagged_mm, image, uid, T in zip(
                self.flagged_mm, self.image_bgr, keyframe_uids[self.keyframe],
                self.T_keyframe_camera, strict=True,
            )
        ]  # fmt: skip


def halved(image_bgr: ByteArray) -> ByteArray:
    """Return an image (H, W, 3) at half the resolution, rounded up."""
    rows, columns = image_bgr.shape[:2]
    even = np.pad(image_bgr, ((0, rows % 2), (0, columns % 2), (0, 0)), 'edge')
    size = even.shape[1] // 2, even.shape[0] // 2
    return np.asarray(cv2.resize(even, size, interpolation=cv2.INTER_AREA), np.uint8)


def doubled(image_bgr: ByteArray) -> ByteArray:
    """Return an image (H, W, 3) at twice the resolution."""
    return image_bgr.repeat(2, axis=0).repeat(2, axis=1)


def _stacked(arrays: Sequence[Array], shape: tuple[int, ...]) -> Array:
    return np.array(arrays).reshape(-1, *shape)
