"""The map's points as a structure of arrays."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hoid_common.values import ByteArray, Float32Array, FloatArray, IntArray
from rgbd_slam.model.soa_table import SoaTable

_INITIAL_CAPACITY = 4096


class PointTable(SoaTable):
    """Rows are map points, index letter j. Columns are written by `Atlas` alone."""

    columns: ClassVar[tuple[str, ...]] = (
        *SoaTable.columns,
        'position_m',
        'view_direction',
        'min_distance_m',
        'max_distance_m',
        'descriptors',
        'num_observations',
        'num_stereo',
        'num_visible',
        'num_found',
        'first_keyframe_uid',
        'reference_keyframe_uid',
        'map_id',
    )

    def __init__(self) -> None:
        n = _INITIAL_CAPACITY
        super().__init__(n)
        self.position_m: FloatArray = np.zeros((n, 3))  # in the map's frame
        self.view_direction: Float32Array = np.zeros(
            (n, 3), np.float32
        )  # unit, mean, from camera to point
        self.min_distance_m: Float32Array = np.zeros(
            n, np.float32
        )  # ORB scale range, see Atlas.refresh_points
        self.max_distance_m: Float32Array = np.zeros(n, np.float32)
        self.descriptors: ByteArray = np.zeros((n, 32), np.uint8)
        self.num_observations: IntArray = np.zeros(n, np.int64)  # keyframes that see the point
        self.num_stereo: IntArray = np.zeros(n, np.int64)  # of them, those that read its depth
        self.num_visible: IntArray = np.zeros(n, np.int64)  # frames whose view it should be in
        self.num_found: IntArray = np.zeros(n, np.int64)  # frames that tracked it
        self.first_keyframe_uid: IntArray = np.zeros(n, np.int64)  # the keyframe that made it
        self.reference_keyframe_uid: IntArray = np.zeros(
            n, np.int64
        )  # whose octave set the scale range
        self.map_id: IntArray = np.zeros(n, np.int64)
