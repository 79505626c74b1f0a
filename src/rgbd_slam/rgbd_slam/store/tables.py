"""The tables of a SLAM map in a database.

Poses and points are in the core's map frame of the node that wrote them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.io.records import Record, column
from hoid_common.store.table import Table
from hoid_common.values import (
    BoolArray,
    ByteArray,
    CameraModel,
    Float32Array,
    FloatArray,
    IntArray,
)


@dataclass(frozen=True, eq=False)
class CameraRow(Record):
    """The columns of a `CameraModel`."""

    size_px: Annotated[IntArray, column('i8', 2)]  # width, height
    pinhole_px: Annotated[FloatArray, column('f8', 4)]  # fx, fy, cx, cy
    distortion: Annotated[FloatArray, column('f8', 'coefficients')]
    is_fisheye: Annotated[BoolArray, column('?', 1)]

    @classmethod
    def of_camera(cls, camera: CameraModel) -> CameraRow:
        return cls(
            np.array([camera.width_px, camera.height_px]),
            np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]),
            np.array(camera.distortion, np.float64),
            np.array([camera.is_fisheye]),
        )

    def camera(self) -> CameraModel:
        width_px, height_px = self.size_px.tolist()
        distortion, is_fisheye = tuple(self.distortion.tolist()), bool(self.is_fisheye[0])
        fx_px, fy_px, cx_px, cy_px = self.pinhole_px.tolist()
        return CameraModel(
            width_px, height_px, fx_px, fy_px, cx_px, cy_px, distortion, is_fisheye=is_fisheye
        )


@dataclass(frozen=True, eq=False)
class Pose(Record):
    """A rigid transform."""

    T: Annotated[FloatArray, column('f8', 4, 4)]


@dataclass(frozen=True, eq=False)
class Covariance(Record):
    """The covariance of a rigid transform, rotation first."""

    matrix: Annotated[FloatArray, column('f8', 6, 6)]


@dataclass(frozen=True, eq=False)
class FeatureRows(Record):
    """The columns of keyframes' features that never change."""

    uv_px: Annotated[Float32Array, column('f4', 'features', 2)]  # undistorted
    depth_m: Annotated[Float32Array, column('f4', 'features')]  # 0: no depth
    octave: Annotated[ByteArray, column('u1', 'features')]
    angle_deg: Annotated[Float32Array, column('f4', 'features')]
    descriptors: Annotated[ByteArray, column('u1', 'features', 32)]


@dataclass(frozen=True, eq=False)
class StateRows(Record):
    """Stored columns of keyframe features that may change after the keyframe was inserted."""

    # Row of the observed point, or NO_POINT.
    point: Annotated[NDArray[np.int32], column('i4', 'features')]
    may_seed: Annotated[BoolArray, column('?', 'features')]


@dataclass(frozen=True, eq=False)
class PointRows(Record):
    """The columns of map points, by ascending row."""

    # Row of the point, to which `StateRows.point` refers.
    row: Annotated[NDArray[np.int32], column('i4', 'points')]
    position_m: Annotated[FloatArray, column('f8', 'points', 3)]
    reference_uid: Annotated[IntArray, column('i8', 'points')]  # uid of the reference keyframe
    # Number of frames that should show it.
    num_visible: Annotated[IntArray, column('i8', 'points')]
    # Number of frames in which it was found.
    num_found: Annotated[IntArray, column('i8', 'points')]


class MapHeader(NamedTuple):
    """The values that a map has only once."""

    camera: CameraModel
    scale_factor: float  # ratio of the scales of two successive octaves
    num_octaves: int
    T_map_core: FloatArray  # (4, 4) pose of the core's map frame in the published map frame
    session: str = ''  # name of the session in which the keyframes have these uids
    stamp_ns: int = 0  # stamp of the last image that was tracked in the map


META = Table(
    'meta',
    'id',  # always 0
    {
        'camera': CameraRow,
        'scale_factor': float,
        'num_octaves': int,
        'T_map_core': Pose,
        'session': str,
        'stamp_ns': int,
    },
)
KEYFRAMES = Table(
    'keyframes',
    'uid',
    # parent_uid: parent in the spanning tree; DEAD for the root of a map.
    {'stamp_ns': int, 'map_id': int, 'parent_uid': int, 'T_core_camera': Pose},
)
FEATURES = Table('features', 'uid', {'features': FeatureRows})
STATES = Table('states', 'uid', {'states': StateRows})
# Each row has CHUNK rows of the point table.
POINTS = Table('points', 'chunk', {'points': PointRows})
LOOPS = Table(
    'loops',
    'id',
    {
        'first_uid': int,
        'second_uid': int,
        'kind': str,
        'num_inliers': int,
        'found_share': float,
        'residual_m': float,
        'is_used': int,
        'T_first_second': Pose,
        'covariance': Covariance,
    },
)
TABLES = (META, KEYFRAMES, FEATURES, STATES, POINTS, LOOPS)
CHUNK = 256
