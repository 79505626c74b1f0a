"""A world of points on a round wall, seen from a ring inside it: loops with a known answer."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import CameraModel, FloatArray, IntArray
from rgbd_slam.config.slam_config import CameraConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera

MODEL = CameraModel(640, 480, 520.0, 515.0, 318.0, 250.0)
CAMERA = StereoCamera.from_model(MODEL, CameraConfig())
_WALL_M = 3.0
_DESCRIPTOR_FLIP = 0.03
_MEMORY = 4  # keyframes back whose points are still known
_FEW = 20  # points that a blurred keyframe recognizes


class RingWorld:
    """Landmarks on the wall, each with another descriptor."""

    def __init__(self, count: int = 3000, seed: int = 0) -> None:
        self.rng = np.random.default_rng(seed)
        angle = self.rng.uniform(0, 2 * np.pi, count)
        radius = _WALL_M + self.rng.uniform(-0.5, 0.5, count)
        height = self.rng.uniform(-1.5, 1.5, count)
        self.points_m = np.stack([radius * np.sin(angle), height, radius * np.cos(angle)], 1)
        self.descriptors = self.rng.integers(0, 256, (count, 32), dtype=np.uint8)

    def frame(self, T_world_camera: FloatArray, stamp_ns: int) -> tuple[Frame, IntArray]:
        """Return the features that a camera sees, and the number of the landmark of each."""
        x = se3.transform(se3.inverse(T_world_camera), self.points_m)
        ahead = np.flatnonzero(x[:, 2] > 0.5)
        pixel = CAMERA.project(x[ahead])
        u_min, v_min, u_max, v_max = CAMERA.bounds_px
        inside = (pixel[:, 0] > u_min) & (pixel[:, 0] < u_max)
        inside &= (pixel[:, 1] > v_min) & (pixel[:, 1] < v_max)
        seen, pixel = ahead[inside], pixel[inside]
        flips = self.rng.random((len(seen), 256)) < _DESCRIPTOR_FLIP
        frame = Frame(
            stamp_ns,
            pixel.astype(np.float32),
            x[seen, 2].astype(np.float32),
            np.full(len(seen), 2, np.uint8),
            np.zeros(len(seen), np.float32),
            self.descriptors[seen] ^ np.packbits(flips, axis=1),
            np.ones(len(seen), np.bool_),
        )
        return frame, seen


def ring_poses(count: int, turns: float = 1.0) -> FloatArray:
    """Return (count, 4, 4) T_world_camera looking outwards from a ring of 1 m."""
    angle = 2 * np.pi * turns * np.arange(count) / count
    zero = np.zeros(count)
    T = se3.exp(np.stack([zero, angle, zero, zero, zero, zero], 1))
    T[:, 0, 3], T[:, 2, 3] = np.sin(angle), np.cos(angle)
    return T


def drifted(poses: FloatArray, step: FloatArray) -> FloatArray:
    """Return poses (N, 4, 4) as measured by odometry with a constant error (6,) per step."""
    out = [poses[0]]
    for n in range(1, len(poses)):
        out.append(out[-1] @ se3.inverse(poses[n - 1]) @ poses[n] @ se3.exp(step))
    return np.array(out)


def mapped(
    atlas: Atlas,
    world: RingWorld,
    truth: FloatArray,
    poses: FloatArray,
    map_id: int = 0,
    blurred: int | None = None,
) -> IntArray:
    """Add keyframes that see the world from `truth` but have the poses `poses`; return their rows.

    A landmark that was out of sight for some keyframes becomes a new point when it is seen again,
    as happens in a tracker with drift. Keyframe number `blurred` recognizes few points, and later
    ones no others of those before it.
    """
    rows: list[int] = []
    known: list[dict[int, int]] = []
    for n, (T_true, T) in enumerate(zip(truth, poses, strict=True)):
        frame, landmark = world.frame(T_true, 1_000_000_000 * map_id + n)
        i = atlas.add_keyframe(frame, T, map_id, rows[-1] if rows else None)
        recent = {w: j for points in known[-_MEMORY:] for w, j in points.items()}
        if n == blurred:
            recent = {w: recent[w] for w in [w for w in landmark.tolist() if w in recent][:_FEW]}
            known.clear()
        j = np.array([recent.get(w, -1) for w in landmark.tolist()], np.int64)
        old, new = np.flatnonzero(j >= 0), np.flatnonzero(j < 0)
        atlas.observe(i, old, j[old])
        x = CAMERA.back_project(frame.measurement_px[new, :2], frame.depth_m[new])
        j[new] = atlas.add_points(i, new, se3.transform(T, x))
        atlas.update_connections(i)
        rows.append(i)
        known.append(dict(zip(landmark.tolist(), j.tolist(), strict=True)))
    atlas.refresh(atlas.points.indices())
    return np.array(rows, np.int64)
