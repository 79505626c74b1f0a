"""A room of points with descriptors, and what a camera sees of it: features with known answers."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import CameraModel, Features, FloatArray, IntArray, Trajectory
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.mapping.map_loading import MapLoading
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.map_state import MapState
from rgbd_slam.model.tracked_frame import TrackedFrame
from rgbd_slam.slam import RgbdSlam

CAMERA = CameraModel(640, 480, 520.0, 520.0, 320.0, 240.0)
PERIOD_NS = 33_000_000
_SCALE = 1.2
_OCTAVES = 8


class World:
    """Points on the walls, the floor and the ceiling of a room of 4 x 2.4 x 5 m."""

    def __init__(self, seed: int = 0, count: int = 9000) -> None:
        rng = np.random.default_rng(seed)
        self._rng = rng
        self.points_m = rng.uniform([-2, -1.2, -2.5], [2, 1.2, 2.5], (count, 3))
        side = rng.integers(0, 3, count)
        snapped = np.take_along_axis(self.points_m, side[:, None], 1)[:, 0]
        limit = np.array([2, 1.2, 2.5])[side]
        self.points_m[np.arange(count), side] = np.where(snapped > 0, limit, -limit)
        self.descriptors = rng.integers(0, 256, (count, 32), dtype=np.uint8)
        self._angle_deg = rng.uniform(0, 360, count)
        self._size_m = rng.uniform(1.0, 5.0, count)

    def features(
        self,
        stamp_ns: int,
        T_world_camera: FloatArray,
        noise_px: float = 0.3,
        limit: int = 900,
        camera: CameraModel = CAMERA,
    ) -> Features:
        """Return at most `limit` features that a camera at a pose sees."""
        rng = self._rng
        x = se3.transform(se3.inverse(T_world_camera), self.points_m)
        j = np.flatnonzero(x[:, 2] > 0.3)
        uv = camera.project_px(x[j])
        size_px = camera.width_px, camera.height_px
        inside = ((uv > 4) & (uv < np.subtract(size_px, 4))).all(1)
        j, uv = j[inside], uv[inside]
        j, uv = j[:limit], uv[:limit]
        depth = x[j, 2]
        size = self._size_m[j] / np.linalg.norm(x[j], axis=1) * camera.fx_px / CAMERA.fx_px
        octave = np.log(size) / np.log(_SCALE)
        octave = np.clip(np.rint(octave), 0, _OCTAVES - 1).astype(np.uint8)
        uv = uv + rng.normal(0, noise_px, uv.shape) * _SCALE ** octave[:, None]
        read = depth + rng.normal(0, 0.0015, len(j)) * depth**2
        flips = np.packbits(rng.random((len(j), 256)) < 0.04, axis=1)
        return Features(
            stamp_ns,
            uv.astype(np.float32),
            np.where(depth < 6, read, 0).astype(np.float32),
            octave,
            self._angle_deg[j].astype(np.float32),
            np.ones(len(j), np.float32),
            self.descriptors[j] ^ flips,
            np.ones(len(j), np.bool_),
        )


def sway(count: int, turn_rad: float = 0.6, way_m: float = 0.8) -> FloatArray:
    """Return (N, 4, 4) poses of one full swing to and fro, starting at the identity."""
    phase = np.linspace(0, 2 * np.pi, count)
    twist = np.zeros((count, 6))
    twist[:, 1] = turn_rad * np.sin(phase)
    twist[:, 3] = way_m * np.sin(phase)
    twist[:, 4] = 0.1 * np.sin(2 * phase)
    twist[:, 5] = 0.3 * (np.cos(phase) - 1)
    return se3.exp(twist)


def empty_frame(stamp_ns: int = 0) -> Frame:
    """Return a frame without features."""
    return Frame(
        stamp_ns, np.empty((0, 3), np.float32), np.empty(0, np.float32), np.empty(0, np.uint8),
        np.empty(0, np.float32), np.empty((0, 32), np.uint8), np.empty(0, np.bool_),
    )  # fmt: skip


def tracked_at(T_map_camera: FloatArray, stamp_ns: int, reference_uid: int = 0) -> TrackedFrame:
    """Return a frame without features, whose reference keyframe is at the origin."""
    none = np.empty(0, np.int64)
    frame = empty_frame(stamp_ns)
    return TrackedFrame(frame, T_map_camera, none, none, reference_uid, T_map_camera)


def position_errors_m(estimate: Trajectory, poses: FloatArray) -> FloatArray:
    """Return the (N,) position errors [m] of a trajectory that starts at the identity."""
    n = estimate.stamps_ns // PERIOD_NS
    expected = se3.inverse(poses[0]) @ poses[n]
    apart = estimate.T_world_camera[:, :3, 3] - expected[:, :3, 3]
    return np.asarray(np.linalg.norm(apart, axis=1))


def load(slam: RgbdSlam, state: MapState, *, keep: bool = False) -> IntArray:
    """Load a saved map, wait until it is loaded, and return the (K,) uids of its keyframes."""
    running = slam.map.atlas if keep else None
    loading = MapLoading(state, slam.map.stereo, SlamConfig(), running=running)
    slam.map.finish_load(loading)
    return loading.uids
