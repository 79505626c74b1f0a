"""Drives a session along a route, image by image, and compares it with the truth."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple, Self

import numpy as np

from hoid_benchmarks.building.virtual_mapper import Delay, with_virtual_mapper
from hoid_benchmarks.building.world.camera import MODEL, FeatureCamera
from hoid_benchmarks.building.world.route import RATE_HZ, START_NS
from hoid_bringup.evaluate.evaluation import evaluate
from hoid_common import se3
from hoid_common.slam_status import SlamState
from hoid_common.values import NS_PER_S, FloatArray, Trajectory
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closer import Join
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.session import SlamSession
from rgbd_slam.store.map_file import MapFile

# A join is false if it contradicts the truth by more than either.
_FALSE_M, _FALSE_DEG = 0.5, 10.0
# The camera has left a view when it looks past the field of view or stands beyond the depth range.
_LEFT_RAD, _LEFT_M = np.deg2rad(60), 6.0


class Image(NamedTuple):
    """The result of one image."""

    stamp_s: float
    state: SlamState
    num_tracked: int  # matched map points
    cpu_ms: float  # of track and learn, without the mapper

    @property
    def is_tracked(self) -> bool:
        """Return whether the pose of the image is known."""
        return self.state is SlamState.TRACKING


class JoinError(NamedTuple):
    """A join that was made, compared with the truth."""

    event: str
    stamp_s: float
    error_m: float
    error_deg: float
    elapsed_s: float  # between the two keyframes
    has_left: bool  # whether the camera has left the view in between, as in every real loop

    @property
    def is_false(self) -> bool:
        """Return whether the two joined places are different places."""
        return self.error_m > _FALSE_M or self.error_deg > _FALSE_DEG


@dataclass(eq=False)
class Drive:
    """A session with a mapper in virtual time, driven along true poses. Use it in a `with`.

    Args:
        camera: Observes the building.
        truth: The true poses of the images.
        delay: How late the mapper answers.
        content: A saved map in which the session starts.
    """

    camera: FeatureCamera
    truth: Trajectory
    delay: Delay = field(default_factory=Delay)
    content: MapFile | None = None

    def __post_init__(self) -> None:
        config = SlamConfig()
        self.session = SlamSession(MODEL, config, RobotFrames(None))
        self.worker = with_virtual_mapper(self.session, config, self.delay)
        self.images: list[Image] = []
        self.joins: list[JoinError] = []
        self._log = _JoinLog(self._add_join)
        if self.content is not None:
            self.session.map.load(self.content)

    def __enter__(self) -> Self:
        self._logger.addHandler(self._log)
        self._level, self._propagates = self._logger.level, self._logger.propagate
        self._logger.setLevel(logging.INFO)
        self._logger.propagate = False
        return self

    def __exit__(self, *_: object) -> None:
        self._logger.removeHandler(self._log)
        self._logger.setLevel(self._level)
        self._logger.propagate = self._propagates
        self.session.close()

    def run(self, first: int = 0, last: int | None = None) -> None:
        """Process the images `first` to `last`, which is excluded."""
        stamps_ns = self.truth.stamps_ns[first:last]
        poses = self.truth.T_world_camera[first:last]
        for stamp_ns, T in zip(stamps_ns.tolist(), poses, strict=True):
            self.process(stamp_ns, T)

    def process(self, stamp_ns: int, T_world_camera: FloatArray) -> Image:
        """Process the image taken at a pose (4, 4)."""
        features = self.camera.observe(T_world_camera, stamp_ns)
        self.worker.proceed(stamp_ns)
        start_s = time.process_time()
        status = self.session.process(features).status
        cpu_ms = 1e3 * (time.process_time() - start_s)
        image = Image(stamp_ns / NS_PER_S, status.state, status.tracked_points, cpu_ms)
        self.images.append(image)
        return image

    @property
    def num_keyframes(self) -> int:
        """Return the number of keyframes in the tracker's map."""
        return len(self.session.map.atlas.keyframes)

    def ate_m(self, kind: str = 'final') -> float:
        """Return the RMSE of the absolute trajectory error; `kind` is `final` or `online`."""
        estimate = self.session.map.trajectory(kind)
        return evaluate(estimate, self.truth).ate_rmse_m

    @property
    def num_lost(self) -> int:
        """Return the number of images without a tracked pose."""
        return sum(not image.is_tracked for image in self.images)

    @property
    def num_false_joins(self) -> int:
        """Return the number of joins that contradict the truth."""
        return sum(join.is_false for join in self.joins)

    def rigid_error(self) -> float:
        """Return the largest entry of R R^T - I of all poses: online, final and keyframes."""
        R = np.concatenate(
            [
                self.session.map.trajectory(kind).T_world_camera[:, :3, :3]
                for kind in ('online', 'final', 'keyframes')
            ]
        )
        return float(np.abs(R @ R.swapaxes(1, 2) - np.eye(3)).max())

    @property
    def _logger(self) -> logging.Logger:
        return logging.getLogger('rgbd_slam')

    def _add_join(self, join: Join) -> None:
        a, b = _image_at(join.place_stamp_ns), _image_at(join.stamp_ns)
        T = self.truth.T_world_camera
        error = se3.inverse(se3.inverse(T[a]) @ T[b]) @ join.edge.T_first_second
        self.joins.append(
            JoinError(
                join.event.value,
                join.stamp_ns / NS_PER_S,
                float(np.linalg.norm(error[:3, 3])),
                float(np.degrees(np.linalg.norm(se3.log(error)[:3]))),
                (join.stamp_ns - join.place_stamp_ns) / NS_PER_S,
                _leaves_view(T[min(a, b) : max(a, b) + 1]),
            )
        )


class _JoinLog(logging.Handler):
    """Receives the joins that the mapper logs."""

    def __init__(self, add: Callable[[Join], None]) -> None:
        super().__init__(logging.INFO)
        self._add = add

    def emit(self, record: logging.LogRecord) -> None:
        """Pass on a join; other messages are dropped."""
        arguments = record.args if isinstance(record.args, tuple) else ()
        for argument in arguments:
            if isinstance(argument, Join):
                self._add(argument)


def _leaves_view(T_world_camera: FloatArray) -> bool:
    """Return whether any pose (N, 4, 4) sees something else than the first pose."""
    away_m = np.linalg.norm(T_world_camera[:, :3, 3] - T_world_camera[0, :3, 3], axis=1)
    cosine = T_world_camera[:, :3, 2] @ T_world_camera[0, :3, 2]
    return bool((away_m > _LEFT_M).any() or (cosine < np.cos(_LEFT_RAD)).any())


def _image_at(stamp_ns: int) -> int:
    """Return the number of the image with this stamp."""
    return round((stamp_ns - START_NS) * RATE_HZ / NS_PER_S)
