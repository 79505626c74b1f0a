"""The frames of a map's first second, whose poses are re-estimated once it is known what rests.

A new map has established nothing: what moves near the camera has its say in the poses until
keyframes disown it. Points that are still seen a second later rest.
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

_FIRST_NS = NS_PER_S  # of a map
_SETTLED_NS = 2 * NS_PER_S  # a keyframe so long after the start has seen what was left of it
_MOST_FRAMES = 120  # of a fast camera


class FirstFrames:
    """Remembers what the first frames of a map saw, and corrects where the trajectory has them.

    Args:
        atlas: The map.
        trajectory: Where the frames are recorded.
        config: Parameters; without a consensus none is re-estimated.
    """

    def __init__(
        self, atlas: Atlas, trajectory: TrajectoryRecorder, config: TrackingConfig
    ) -> None:
        self._atlas = atlas
        self._trajectory = trajectory
        self._config = config
        self._inv_sigma2 = atlas.octave_scale**-2.0
        self._start_ns: int | None = None  # of the map that is looked at
        self._frames: deque[tuple[int, TrackedFrame]] = deque(maxlen=_MOST_FRAMES)

    def begin(self, stamp_ns: int) -> None:
        """Look at a new map's frames, and no longer at another's."""
        self._frames.clear()
        self._start_ns = stamp_ns if self._config.consensus.enabled else None

    def add(self, tracked: TrackedFrame) -> None:
        """Take note of the frame that was recorded last, if it is one of the first."""
        start_ns = self._start_ns
        if start_ns is not None and 0 < tracked.frame.stamp_ns - start_ns < _FIRST_NS:
            self._frames.append((len(self._trajectory) - 1, tracked))

    def revise_next(self, camera: StereoCamera) -> None:
        """Solve for the pose of one of them, if the map knows by now what rests: one an image.

        Args:
            camera: With the noise measured so far.
        """
        keyframes, start_ns = self._atlas.keyframes, self._start_ns
        if not self._frames or start_ns is None:
            return
        rows = keyframes.indices()
        rows = rows[~keyframes.is_loaded[rows]]
        since_ns = keyframes.stamp_ns[rows] - start_ns
        if (since_ns < _SETTLED_NS).all():
            return
        rests = np.zeros(self._atlas.points.capacity + 1, np.bool_)  # the last: NO_POINT
        rests[keyframes.point_of_feature[rows[since_ns >= _FIRST_NS]]] = True
        rests[NO_POINT] = False
        self._revise(*self._frames.popleft(), rests, camera)

    def _revise(
        self, n: int, tracked: TrackedFrame, rests: BoolArray, camera: StereoCamera
    ) -> None:
        """Solve for the pose of frame `n` by points known to rest, if it sees enough of them."""
        points = tracked.current_points(self._atlas)
        k = np.flatnonzero(points != NO_POINT)
        j = points[k]
        T_map_camera = self._trajectory.pose(n)
        config = self._config.consensus
        if T_map_camera is None or np.count_nonzero(rests[j]) < config.min_well_observed:
            return
        problem = PoseProblem(
            self._atlas.points.position_m[j],
            tracked.frame.measurement_px[k].astype(np.float64),
            self._inv_sigma2[tracked.frame.octave[k]],
        )
        consensus = PoseConsensus(camera, config)
        estimate = consensus.solve(problem, rests[j], se3.inverse(T_map_camera)).estimate
        if np.count_nonzero(estimate.inliers) >= self._config.min_inliers:
            self._trajectory.revise(n, se3.inverse(estimate.T_camera_map))
