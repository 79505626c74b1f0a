"""How the camera is expected to move: as fast as it did last, whatever the time between images."""

from __future__ import annotations

import numpy as np

from hoid_common import se3
from hoid_common.values import S_PER_NS, FloatArray

_HORIZON_S = 0.25  # a hand changes its motion; nobody knows where it is after a longer gap


class ConstantVelocity:
    """Predicts motions between two images from the last one observed; at rest to begin with."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Expect no motion, until one is observed."""
        self._twist_per_s: FloatArray = np.zeros(6)

    def observe(self, T_camera_last: FloatArray, elapsed_ns: int) -> None:
        """Take the motion (4, 4) between two images; stamps that stand still say no speed."""
        if elapsed_ns > 0:
            self._twist_per_s = se3.log(T_camera_last) / (S_PER_NS * elapsed_ns)
        else:
            self.forget()

    def predict(self, elapsed_ns: int) -> FloatArray:
        """Return T_camera_last (4, 4), the motion expected in a time."""
        elapsed_s = min(max(S_PER_NS * elapsed_ns, 0.0), _HORIZON_S)
        return se3.exp(elapsed_s * self._twist_per_s)
