"""The value types that processing stages exchange: camera, frame, detections, features, verdicts.

`T_a_b` maps points of frame b to frame a; pixels are `(u, v)` with the origin at the center of the
top-left pixel; boxes are `(x1, y1, x2, y2)`, ends exclusive; stamps are integer nanoseconds. The
optical frame of a camera has x to the right, y down, z forward (REP 103). Index letters: i frame
or keyframe, j map point, k feature.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import Any

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
"""Size of an ORB descriptor: 256 binary tests (Rublee et al., 2011)."""
PERSON = 'person'
"""Name of the class of people, as in COCO."""
UNKNOWN = 'unknown'
"""Class name of a moving region that no detector has classified."""
EQUIDISTANT = 'equidistant'
DISTORTION_MODELS = ('plumb_bob', 'rational_polynomial', EQUIDISTANT)
"""The supported distortion models of sensor_msgs/CameraInfo.

The models have up to 5, 8 to 14, and 4 coefficients, in this order.
"""

MAX_PIXELS = 7680 * 4320
"""Largest image that is accepted: 8K, four times the largest camera tested; 100 MB as BGR."""
MAX_NAME_LENGTH = 100
"""Longest class name that is accepted, in characters. Chosen: COCO's longest has 14."""

# Number of coefficients of OpenCV's rational model: k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3,
# s4, tau_x, tau_y.
_NUM_COEFFICIENTS = 14
_NUM_FISHEYE = 4  # coefficients of OpenCV's fisheye model: k1, k2, k3, k4
_MAX_COEFFICIENT = 1e4  # chosen far above the coefficients of real lenses; not tuned
# Limits of the focal length, as a ratio to the longer image side: fields of view of 169 and 0.6
# degrees. Chosen beyond those of any pinhole camera.
_FOCAL_PER_SIDE = (0.05, 100.0)


@dataclass(frozen=True)
class CameraModel:
    """Intrinsics of a pinhole camera with plumb-bob, rational or equidistant lens distortion.

    Focal lengths are in pixels; the principal point is relative to the center of the first pixel.
    `distortion` has up to 14 coefficients in the order of OpenCV, or k1 to k4 of the equidistant
    model if `is_fisheye`; all are zero for a rectified camera. ConfigError for values that no real
    camera has.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()
    is_fisheye: bool = False

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
                f'camera center must be near the image of {width}x{height} px, '
                f'got cx={self.cx_px} cy={self.cy_px}'
            )
        if not (np.abs(self.distortion) <= _MAX_COEFFICIENT).all() or any(
            self.distortion[self._num_coefficients :]
        ):
            raise ConfigError(
                f'camera distortion must be up to {self._num_coefficients} numbers in the order '
                f'of OpenCV, got {list(self.distortion)}'
            )

    @property
    def _num_coefficients(self) -> int:
        return _NUM_FISHEYE if self.is_fisheye else _NUM_COEFFICIENTS

    @property
    def size_px(self) -> tuple[int, int]:
        return self.width_px, self.height_px

    @property
    def distortion_model(self) -> str:
        return EQUIDISTANT if self.is_fisheye else DISTORTION_MODELS[len(self.distortion) > 5]

    def scaled_to(self, size_px: tuple[int, int]) -> CameraModel | None:
        """Return the camera for another image size (px); None unless one size is a multiple."""
        (width, height), (own_width, own_height) = size_px, self.size_px
        is_whole = width > 0 and 0 in (width % own_width, own_width % width)
        if not is_whole or width * own_height != height * own_width:
            return None
        scale = width / own_width
        # The center of the first pixel is at 0, so that the image begins at -0.5.
        cx_px, cy_px = (scale * (c + 0.5) - 0.5 for c in (self.cx_px, self.cy_px))
        fx_px, fy_px = scale * self.fx_px, scale * self.fy_px
        lens = self.distortion, self.is_fisheye
        return CameraModel(width, height, fx_px, fy_px, cx_px, cy_px, *lens)

    @cached_property
    def matrix(self) -> FloatArray:
        return np.array([[self.fx_px, 0, self.cx_px], [0, self.fy_px, self.cy_px], [0, 0, 1.0]])

    @cached_property
    def _coefficients(self) -> FloatArray:
        num = self._num_coefficients
        return np.array((*self.distortion, *(0.0,) * num)[:num])

    def undistort_px(self, uv_px: Float32Array) -> Float32Array:
        """Return the pixels (N, 2) that the same camera would see without lens distortion."""
        if not any(self.distortion) or len(uv_px) == 0:
            return uv_px
        pixels = uv_px.reshape(-1, 1, 2)
        undistort = cv2.fisheye.undistortPoints if self.is_fisheye else cv2.undistortPoints
        out = undistort(pixels, self.matrix, self._coefficients, P=self.matrix)
        return np.asarray(out.reshape(-1, 2), np.float32)

    def project_px(self, points_camera_m: FloatArray) -> FloatArray:
        """Return the pixels (N, 2), maybe outside the image, of points (N, 3) in m with z > 0."""
        x, y = (points_camera_m[:, :2] / points_camera_m[:, 2:]).T
        if (
            any(self.distortion[-2:]) and len(self.distortion) == _NUM_COEFFICIENTS
        ):  # the sensor is tilted
            zero = np.zeros(3)
            out, _ = cv2.projectPoints(
                points_camera_m, zero, zero, self.matrix, self._coefficients
            )
            return np.asarray(out.reshape(-1, 2), np.float64)
        if any(self.distortion):
            x, y = self._distorted(x, y)
        return np.stack([x * self.fx_px + self.cx_px, y * self.fy_px + self.cy_px], axis=1)

    def _distorted(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distorted coordinates (N,), (N,) of normalized image coordinates (z = 1).

        `cv2.projectPoints` takes 17 times as long, because it also computes Jacobians.
        """
        xy, r2 = x * y, x * x + y * y
        if self.is_fisheye:
            r = np.maximum(np.sqrt(r2), np.finfo(np.float64).tiny)
            angle = np.arctan(r)
            powers = angle[:, None] ** np.arange(3, 3 + 2 * _NUM_FISHEYE, 2)
            scale = (angle + powers @ self._coefficients) / r
            return x * scale, y * scale
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, _, _ = self._coefficients
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        if k4 or k5 or k6:
            radial /= 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        return (
            x * radial + 2 * p1 * xy + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * xy + r2 * (s3 + r2 * s4),
        )


@dataclass(frozen=True, eq=False)
class RgbdFrame:
    """One color image and the depth image that is registered to it."""

    stamp_ns: int  # stamp of the color image
    image_bgr: ByteArray  # (H, W, 3) uint8
    depth_m: Float32Array  # (H, W) along the optical axis; 0 = no depth

    @property
    def size_px(self) -> tuple[int, int]:
        height, width = self.depth_m.shape
        return width, height


@dataclass(frozen=True, eq=False)
class Detections:
    """Bounding boxes that a detector found in one image; MessageError if arrays disagree."""

    stamp_ns: int  # stamp of the image
    boxes_xyxy_px: Float32Array  # (N, 4) left, top, right, bottom in the full image
    class_names: tuple[str, ...]  # N names of the detector's classes, such as 'person'
    scores: Float32Array  # (N,) confidence in [0, 1]

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
        return Detections(stamp_ns, np.empty((0, 4), np.float32), (), np.empty(0, np.float32))


@dataclass(frozen=True, eq=False)
class Features:
    """N ORB features of one image, as a structure of arrays; MessageError if they disagree."""

    stamp_ns: int  # stamp of the color image
    uv_px: Float32Array  # (N, 2) at full resolution, as imaged (lens distortion not removed)
    depth_m: Float32Array  # (N,) along the optical axis; 0 = no depth, or at a depth edge
    octave: ByteArray  # (N,) level of the image pyramid; 0 = full resolution
    angle_deg: Float32Array  # (N,) orientation in [0, 360), clockwise from the image's x axis
    response: Float32Array  # (N,) corner strength, without unit
    descriptors: ByteArray  # (N, 32) uint8: 256 bits each
    # (N,) False: the feature may lie on a moving object. It is tracked, but does not become a map
    # point.
    may_seed: BoolArray

    def __post_init__(self) -> None:
        n = len(self.octave)
        shapes = {'uv_px': (n, 2), 'descriptors': (n, DESCRIPTOR_BYTES)}
        for name, values in self._arrays().items():
            if values.shape != (shape := shapes.get(name, (n,))):
                raise MessageError(f'features: {name} has shape {values.shape}, expected {shape}')

    def __len__(self) -> int:
        return len(self.octave)

    def select(self, keep: BoolArray | IntArray) -> Features:
        chosen = {name: values[keep] for name, values in self._arrays().items()}
        return Features(self.stamp_ns, **chosen)

    def _arrays(self) -> dict[str, NDArray[Any]]:
        return {name: values for name, values in vars(self).items() if name != 'stamp_ns'}


@dataclass(frozen=True, eq=False)
class FeatureVerdicts:
    """The filter's final verdict on the N features of an image: which features are dynamic."""

    stamp_ns: int  # stamp of the image, as in its `Features`
    # (N,) True: the feature lies on a moving object and must be removed. An empty array means that
    # no feature does.
    is_dynamic: BoolArray


# Chosen: an object counts as at rest if nobody has handled or moved it for so long, both in the
# filter's verdicts and in the scene.
REST_S = 1.0


class ObjectState(Enum):
    """The state of a person or an object; hoid_msgs/ObjectState explains each value."""

    AT_REST = 0
    PERSON = 1
    HANDLED = 2
    PREDICTED = 3
    REMEMBERED = 4
    MOVING = 5
    MOVED = 6
    GONE = 7
    TENTATIVE = 8

    @property
    def is_at_rest(self) -> bool:
        """Return whether the object stands still: where it was first seen, or put down later."""
        return self in (ObjectState.AT_REST, ObjectState.MOVED)


@dataclass(frozen=True)
class DynamicObject:
    """One detected or predicted object, and why it is dynamic or static."""

    class_name: str  # such as 'cup'; UNKNOWN for a moving region without a detection
    box_xyxy_px: tuple[float, float, float, float]  # left, top, right, bottom in the full image
    score: float  # confidence of the detection, in [0, 1]
    track_id: int  # the same for the same object over time; -1 when the object is not tracked
    state: ObjectState  # why it is dynamic or static
    # Share of the object's box that the box of a person covers, in [0, 1].
    overlap_ratio: float = 0.0
    # Absolute difference between the depths of the object and of that person; NaN if unknown.
    depth_gap_m: float = NAN
    # Center of the object in the camera's optical frame; NaN if depth or camera is unknown.
    center_camera_m: tuple[float, float, float] = (NAN, NAN, NAN)
    # Width and height of the box at the object's depth; NaN if depth or camera is unknown.
    size_m: tuple[float, float] = (NAN, NAN)
    # Velocity relative to the world, along the axes of the camera's optical frame; NaN unless the
    # object is MOVING with known velocity.
    velocity_camera_mps: tuple[float, float, float] = (NAN, NAN, NAN)

    @property
    def is_dynamic(self) -> bool:
        return not self.state.is_at_rest


@dataclass(frozen=True, eq=False)
class FilterResult:
    """The filter's output for one frame: static features and classified objects."""

    features: Features  # the features that are kept
    objects: tuple[DynamicObject, ...]  # static objects included
    removed_uv_px: Float32Array  # (M, 2) pixels of the removed features, for the debug image
    num_features_in: int  # features that were detected
    num_removed: int  # features that were removed as dynamic
    # Duration (ms) of the stages 'extract' and 'filter'. The clock is monotonic, since reading the
    # clock of the thread would interrupt the thread on a busy computer (decision 016).
    stage_ms: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """N poses of the camera's optical frame in a world-fixed frame, in order of time."""

    stamps_ns: IntArray  # (N,)
    T_world_camera: FloatArray  # (N, 4, 4), translation in m

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @staticmethod
    def joined(parts: Iterable[Trajectory]) -> Trajectory:
        each = [Trajectory(np.empty(0, np.int64), np.empty((0, 4, 4))), *parts]
        stamps_ns = np.concatenate([part.stamps_ns for part in each])
        return Trajectory(stamps_ns, np.concatenate([part.T_world_camera for part in each]))
