"""Re-estimation of the poses of a map's first second (decision 034).

In a new map no point is well observed yet, so that moving objects near the camera bias the poses.
A second later, points that keyframes still observe are static, and these poses are estimated again
from them. Only the recorded trajectory changes.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from hoid_common import se3
from hoid_common.values import NS_PER_S, BoolArray
from rgbd_slam.config.slam_config import TrackingConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.tracked_frame import TrackedFrame
from rgbd_slam.model.trajectory import TrajectoryRecorder
from rgbd_slam.optimize.pose_consensus import PoseConsensus
from rgbd_slam.optimize.pose_optimizer import PoseProblem

_WARM_UP_NS = NS_PER_S  # poses up to this time after a map's start are re-estimated (decision 034)
# Chosen: at this time after a map's start, enough keyframes have observed the static points.
_SETTLED_NS = 2 * NS_PER_S
_MAX_FRAMES = 120  # chosen, to limit the memory: a second at 120 Hz


class WarmUp:
    """Stores the first frames of a map and corrects their poses in the trajectory."""

    def __init__(
        self, atlas: Atlas, trajectory: TrajectoryRecorder, config: TrackingConfig
    ) -> None:
        self._atlas = atlas
        self._trajectory = trajectory
        self._config = config
        self._start_ns: int | None = None  # stamp of the first frame of the map
        # Frames of the map's first second, each with its index in the trajectory.
        self._frames: deque[tuple[int, TrackedFrame]] = deque(maxlen=_MAX_FRAMES)

    def begin(self, stamp_ns: int) -> None:
        """Start a new map with the stamp of its first frame; drop stored frames."""
        self._frames.clear()
        self._start_ns = stamp_ns if self._config.consensus.enabled else None

    def add(self, tracked: TrackedFrame) -> None:
        """Store the last frame of the trajectory if it is in the map's first second."""
        start_ns = self._start_ns
        if start_ns is not None and 0 < tracked.frame.stamp_ns - start_ns < _WARM_UP_NS:
            self._frames.append((len(self._trajectory) - 1, tracked))

    def reestimate_next(self, camera: StereoCamera) -> None:
        """Re-estimate one stored pose, if a keyframe is 2 s later than the first frame.

        Call this once per image, so that the time per image is limited.
        """
        keyframes, start_ns = self._atlas.keyframes, self._start_ns
        if not self._frames or start_ns is None:
            return
        rows = keyframes.indices()
        rows = rows[~keyframes.is_loaded[rows]]
        since_ns = keyframes.stamp_ns[rows] - start_ns
        if (since_ns < _SETTLED_NS).all():
            return
        is_static = np.zeros(self._atlas.points.capacity + 1, np.bool_)  # last: NO_POINT
        is_static[keyframes.point_of_feature[rows[since_ns >= _WARM_UP_NS]]] = True
        is_static[NO_POINT] = False
        self._reestimate(*self._frames.popleft(), is_static, camera)

    def _reestimate(
        self, n: int, tracked: TrackedFrame, is_static: BoolArray, camera: StereoCamera
    ) -> None:
        """Replace the pose of frame `n` in the trajectory by one estimated from its static points.

        It is kept if the frame observes too few points in the mask `is_static` (capacity + 1,), if
        too few matches fit the new pose, or if the trajectory has no pose of the frame.
        """
        points = tracked.current_points(self._atlas)
        k = np.flatnonzero(points != NO_POINT)
        j = points[k]
        T_map_camera = self._trajectory.pose(n)
        config = self._config.consensus
        if T_map_camera is None or np.count_nonzero(is_static[j]) < config.min_well_observed:
            return
        position_m = self._atlas.points.position_m[j]
        problem = PoseProblem.of(tracked.frame, k, position_m, self._atlas.octave_scale)
        consensus = PoseConsensus(camera, config)
        estimate = consensus.solve(problem, is_static[j], se3.inverse(T_map_camera)).estimate
        if np.count_nonzero(estimate.inliers) >= self._config.min_inliers:
            self._trajectory.revise(n, se3.inverse(estimate.T_camera_map))
