"""The values that stages hand to each other; `hoid_common.ros.conversions` has their messages.

Conventions (docs/architecture.md): `T_a_b` maps points of frame b to frame a; pixels are `(u, v)`
with the origin at the centre of the top-left pixel; boxes are `(x1, y1, x2, y2)` with x2, y2
exclusive; stamps are integer nanoseconds. Index letters: i frame or keyframe, j map point, k
feature.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import ConfigError, MessageError

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
ByteArray = NDArray[np.uint8]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NAN = float('nan')
NS_PER_S = 1_000_000_000
S_PER_NS = 1e-9
DESCRIPTOR_BYTES = 32
PERSON = 'person'
UNKNOWN = 'unknown'
"""The class of what moves and was not detected."""
DISTORTION_MODELS = ('plumb_bob', 'rational_polynomial')
"""Names in ROS of the lens models whose coefficients OpenCV takes: up to five, and eight."""

MAX_PIXELS = 7680 * 4320
"""Of an image: 8K, four times what any camera here gives; 100 MB as BGR."""
MAX_NAME_LENGTH = 100
"""Of a class, in characters."""

_LENS_TERMS = 8
_MAX_LENS_TERM = 1e4
_FOCAL_PER_SIDE = (0.05, 100.0)  # of the longer side: views of 169 and of 0.6 degrees


@dataclass(frozen=True)
class CameraModel:
    """A pinhole camera with a lens of sensor_msgs/CameraInfo's plumb-bob or rational model.

    Args:
        distortion: k1, k2, p1, p2, k3, k4, k5, k6 (OpenCV order) or the first few of them; empty
            or all zero for a rectified camera.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        width, height, focal = self.width_px, self.height_px, (self.fx_px, self.fy_px)
        if min(width, height) <= 0 or width * height > MAX_PIXELS:
            raise ConfigError(
                f'camera size must be positive and at most {MAX_PIXELS} px, got {width}x{height}'
            )
        least, most = (ratio * max(width, height) for ratio in _FOCAL_PER_SIDE)
        if not all(least <= length <= most for length in focal):  # also refuses NaN
            raise ConfigError(
                f'camera focal lengths must be in [{least:g}, {most:g}] px at {width}x{height}, '
                f'got fx={self.fx_px} fy={self.fy_px}'
            )
        if not (-width <= self.cx_px <= 2 * width and -height <= self.cy_px <= 2 * height):
            raise ConfigError(
                f'camera centre must be near the image of {width}x{height} px, '
                f'got cx={self.cx_px} cy={self.cy_px}'
            )
        if not (np.abs(self.distortion) <= _MAX_LENS_TERM).all() or any(
            self.distortion[_LENS_TERMS:]
        ):
            raise ConfigError(
                f'camera distortion must be up to {_LENS_TERMS} numbers, k1 k2 p1 p2 k3 k4 k5 k6, '
                f'got {list(self.distortion)}'
            )

    @property
    def size_px(self) -> tuple[int, int]:
        """Return width, height."""
        return self.width_px, self.height_px

    @property
    def distortion_model(self) -> str:
        """Return the lens model's name in ROS, by the number of its coefficients."""
        return DISTORTION_MODELS[len(self.distortion) > 5]

    @cached_property
    def matrix(self) -> FloatArray:
        """Return K, (3, 3)."""
        return np.array([[self.fx_px, 0, self.cx_px], [0, self.fy_px, self.cy_px], [0, 0, 1.0]])

    @cached_property
    def _lens(self) -> FloatArray:
        """Return all (8,) coefficients."""
        return np.array((*self.distortion, *(0.0,) * _LENS_TERMS)[:_LENS_TERMS])

    def undistort_px(self, uv_px: Float32Array) -> Float32Array:
        """Return the (N, 2) pixels where a camera with this K and no distortion sees them."""
        if not any(self.distortion) or len(uv_px) == 0:
            return uv_px
        out = cv2.undistortPoints(uv_px.reshape(-1, 1, 2), self.matrix, self._lens, P=self.matrix)
        return np.asarray(out.reshape(-1, 2), np.float32)

    def project_px(self, points_camera_m: FloatArray) -> FloatArray:
        """Return the (N, 2) pixels, as imaged, of (N, 3) points (z > 0) in the optical frame."""
        x, y = (points_camera_m[:, :2] / points_camera_m[:, 2:]).T
        if any(self.distortion):
            x, y = self._distorted(x, y)
        return np.stack([x * self.fx_px + self.cx_px, y * self.fy_px + self.cy_px], axis=1)

    def _distorted(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Bend (N,) image coordinates at z = 1 as the lens does (OpenCV's camera model).

        `cv2.projectPoints` gives the same 17 times slower, as it makes Jacobians of everything.
        """
        k1, k2, p1, p2, k3, k4, k5, k6 = self._lens
        xy, r2 = x * y, x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        if k4 or k5 or k6:
            radial /= 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        return (
            x * radial + 2 * p1 * xy + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * xy,
        )


@dataclass(frozen=True, eq=False)
class RgbdFrame:
    """One colour image and the depth image registered to it."""

    stamp_ns: int  # of the colour image
    image_bgr: ByteArray  # (H, W, 3)
    depth_m: Float32Array  # (H, W); 0 = no reading

    @property
    def size_px(self) -> tuple[int, int]:
        """Return width, height."""
        height, width = self.depth_m.shape
        return width, height


@dataclass(frozen=True, eq=False)
class Detections:
    """What a detector saw in one image."""

    stamp_ns: int  # of the image
    boxes_xyxy_px: Float32Array  # (N, 4)
    class_names: tuple[str, ...]  # N
    scores: Float32Array  # (N,) in [0, 1]

    def __post_init__(self) -> None:
        n = len(self.class_names)
        if self.boxes_xyxy_px.shape != (n, 4) or self.scores.shape != (n,):
            raise MessageError(
                f'detections: {n} classes, boxes {self.boxes_xyxy_px.shape}, '
                f'scores {self.scores.shape} disagree'
            )
        if (length := max(map(len, self.class_names), default=0)) > MAX_NAME_LENGTH:
            raise MessageError(
                f'detections: a class name has {length} characters, more than {MAX_NAME_LENGTH}'
            )

    def __len__(self) -> int:
        return len(self.class_names)

    @staticmethod
    def none(stamp_ns: int) -> Detections:
        """Return an empty set of detections."""
        return Detections(stamp_ns, np.empty((0, 4), np.float32), (), np.empty(0, np.float32))


@dataclass(frozen=True, eq=False)
class Features:
    """ORB features of one image as structure of arrays; pixels as imaged (not undistorted)."""

    stamp_ns: int
    uv_px: Float32Array  # (N, 2), level-0 pixels
    depth_m: Float32Array  # (N,); 0 = no reading
    octave: ByteArray  # (N,)
    angle_deg: Float32Array  # (N,) in [0, 360)
    response: Float32Array  # (N,)
    descriptors: ByteArray  # (N, 32)
    may_seed: BoolArray  # (N,); False: what may move after all, to be tracked but not mapped

    def __post_init__(self) -> None:
        n = len(self.octave)
        shapes = {
            'uv_px': (self.uv_px.shape, (n, 2)),
            'depth_m': (self.depth_m.shape, (n,)),
            'angle_deg': (self.angle_deg.shape, (n,)),
            'response': (self.response.shape, (n,)),
            'descriptors': (self.descriptors.shape, (n, DESCRIPTOR_BYTES)),
            'may_seed': (self.may_seed.shape, (n,)),
        }
        for name, (got, want) in shapes.items():
            if got != want:
                raise MessageError(f'features: {name} has shape {got}, expected {want}')

    def __len__(self) -> int:
        return len(self.octave)

    def select(self, keep: BoolArray | IntArray) -> Features:
        """Return the features at a (N,) mask or list of indices."""
        return Features(
            self.stamp_ns,
            self.uv_px[keep],
            self.depth_m[keep],
            self.octave[keep],
            self.angle_deg[keep],
            self.response[keep],
            self.descriptors[keep],
            self.may_seed[keep],
        )


@dataclass(frozen=True, eq=False)
class FeatureVerdicts:
    """The filter's final word on the N features of an image that was judged before."""

    stamp_ns: int
    is_dynamic: BoolArray  # (N,); True: on what moves after all


class Reason(Enum):
    """Why an object counts as dynamic or not; the values are those of hoid_msgs/DynamicObject."""

    STATIC = 0
    PERSON = 1
    HANDLED = 2
    PREDICTED = 3
    REMEMBERED = 4
    MOVING = 5


@dataclass(frozen=True)
class DynamicObject:
    """One detected or predicted object and the filter's verdict on it."""

    class_name: str
    box_xyxy_px: tuple[float, float, float, float]
    score: float
    track_id: int  # -1 when the strategy does not track
    reason: Reason
    overlap_ratio: float = 0.0  # shared area / own area, over the people in view; in [0, 1]
    depth_gap_m: float = NAN  # |object - person| at the sample boxes; NaN when unknown
    center_camera_m: tuple[float, float, float] = (NAN, NAN, NAN)  # when depth does not allow
    size_m: tuple[float, float] = (NAN, NAN)  # width, height at that depth
    velocity_camera_mps: tuple[float, float, float] = (NAN, NAN, NAN)  # against the world

    @property
    def is_dynamic(self) -> bool:
        """Return whether features on the object are dropped."""
        return self.reason is not Reason.STATIC


@dataclass(frozen=True, eq=False)
class FilterResult:
    """What the filter makes of one frame."""

    features: Features  # kept
    objects: tuple[DynamicObject, ...]
    removed_uv_px: Float32Array  # (M, 2), dropped features, for pictures
    num_features_in: int
    num_removed: int
    stage_ms: dict[str, float] = field(default_factory=dict)  # 'extract', 'filter'


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of the camera's optical frame in a fixed frame, in order of time."""

    stamps_ns: IntArray  # (N,)
    T_world_camera: FloatArray  # (N, 4, 4)

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @staticmethod
    def joined(parts: Iterable[Trajectory]) -> Trajectory:
        """Return parts as one, in their order."""
        each = [Trajectory(np.empty(0, np.int64), np.empty((0, 4, 4))), *parts]
        stamps_ns = np.concatenate([part.stamps_ns for part in each])
        return Trajectory(stamps_ns, np.concatenate([part.T_world_camera for part in each]))
