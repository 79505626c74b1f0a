"""The pose of one frame from its correspondences with landmarks of the map."""

from __future__ import annotations

from typing import NamedTuple

from hoid_common.values import FloatArray
from rgbd_slam.config.consensus_config import ConsensusConfig
from rgbd_slam.matching.landmarks import Correspondences
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.optimize.pose_consensus import Consensus, PoseConsensus
from rgbd_slam.optimize.pose_optimizer import PosePrior, PoseProblem


class FramePose(NamedTuple):
    """An estimated pose of a frame, and the correspondences that fit it."""

    consensus: Consensus
    inliers: Correspondences

    @property
    def T_camera_map(self) -> FloatArray:  # noqa: N802
        return self.consensus.estimate.T_camera_map


class FramePoseEstimator:
    """Estimates poses of frames in a map.

    `camera` has the measured noise; `prior` is one of the pose of the current frame, if there is
    any.
    """

    def __init__(self, camera: StereoCamera, atlas: Atlas, config: ConsensusConfig) -> None:
        self.camera = camera
        self.prior: PosePrior | None = None
        self._atlas, self._config = atlas, config

    def estimate(
        self,
        frame: Frame,
        found: Correspondences,
        T_camera_map: FloatArray,
        *,
        is_initial: bool = False,
    ) -> FramePose:
        """Return the pose optimized on correspondences from an initial one, and those that fit it.

        `is_initial` states that the pose only guides the search for more matches.
        """
        problem = PoseProblem.of(frame, found.k, found.position_m, self._atlas.octave_scale)
        num_observations = self._atlas.points.num_observations[found.point]
        is_in_map = found.point != NO_POINT
        is_well_observed = is_in_map & (num_observations >= self._config.min_observations)
        consensus = PoseConsensus(self.camera, self._config, self.prior).solve(
            problem, is_well_observed, T_camera_map, is_initial=is_initial
        )
        return FramePose(consensus, found.select(consensus.estimate.inliers))
