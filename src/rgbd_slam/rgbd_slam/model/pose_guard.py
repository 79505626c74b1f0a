"""Protection of maps, trajectories and messages from poses that are not rigid or not finite."""

from __future__ import annotations

import logging
import time

import numpy as np

from hoid_common import se3
from hoid_common.log_throttle import LogThrottle
from hoid_common.values import BoolArray, FloatArray
from rgbd_slam.model.points import MAX_POSITION_M

_LOG_PERIOD_S = 5.0  # chosen: shortest time between two warnings about poses with the same name

_logger = logging.getLogger(__name__)


class PoseGuard:
    """Refuses and counts poses that are not rigid, not finite or beyond 100 km.

    An invalid result of a computation then costs an image or a keyframe, but not the map.
    """

    def __init__(self) -> None:
        self.num_refused = 0
        self._num_taken = 0
        self._throttle = LogThrottle(_LOG_PERIOD_S)

    def are_valid(self, T: FloatArray, name: str) -> BoolArray:
        """Return (N,) whether poses (N, 4, 4) are valid; count and log the others, by `name`."""
        is_valid = se3.is_rigid(T) & (np.abs(T[..., :3, 3]) < MAX_POSITION_M).all(-1)
        num_refused = int(np.count_nonzero(~is_valid))
        if num_refused:
            self.num_refused += num_refused
            if self._throttle.allow(name, time.monotonic()) is not None:
                _logger.warning(
                    'poses of %s are no rigid transforms and are left out; '
                    'please report this with a recording',
                    name,
                )
        return np.asarray(is_valid)

    def is_valid(self, T: FloatArray, name: str) -> bool:
        return bool(self.are_valid(T, name))

    def take(self) -> int:
        """Return the number of poses that were refused since the last call."""
        taken, self._num_taken = self._num_taken, self.num_refused
        return self.num_refused - taken
