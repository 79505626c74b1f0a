"""A recording with another order, selection or timing of its images."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_bags.sequence import Sequence
from hoid_bags.tum.association import associate
from hoid_common.values import CameraModel, IntArray, RgbdFrame, Trajectory


class Arrangement(NamedTuple):
    """Order and stamps of the images of a rearranged recording."""

    order: IntArray  # (M,) indices of the recording's images
    stamps_ns: IntArray  # (M,), ascending


class RearrangedSequence:
    """A rearranged recording. Ground truth follows the images; there are no true detections.

    Args:
        base: The recording in its original order.
        arrange: Returns the arrangement for the stamps (N,) of its images.
    """

    true_detections = None

    def __init__(self, base: Sequence, arrange: Callable[[IntArray], Arrangement]) -> None:
        self.name = base.name
        self.camera: CameraModel = base.camera
        self.fault = base.fault
        # Images do not fit in memory.
        self._folder = tempfile.TemporaryDirectory(prefix='hoid-rearranged-')
        self._paths = [_spool(frame, Path(self._folder.name)) for frame in base]
        recorded_ns = np.array([int(path.stem) for path in self._paths])
        self._order, self._stamps_ns = arrange(recorded_ns)
        self.ground_truth = self._rearranged(base.ground_truth, recorded_ns)

    def _rearranged(self, truth: Trajectory | None, recorded_ns: IntArray) -> Trajectory | None:
        """Return the ground truth of those rearranged frames that have ground truth."""
        if truth is None:
            return None
        pairs = associate(recorded_ns, truth.stamps_ns)
        of_frame = np.full(len(recorded_ns), -1)
        of_frame[pairs[:, 0]] = pairs[:, 1]
        rows = of_frame[self._order]
        known = rows >= 0
        return Trajectory(self._stamps_ns[known], truth.T_world_camera[rows[known]])

    def __len__(self) -> int:
        return len(self._order)

    def __iter__(self) -> Iterator[RgbdFrame]:
        for stamp_ns, i in zip(self._stamps_ns.tolist(), self._order.tolist(), strict=True):
            with np.load(self._paths[i]) as saved:
                yield RgbdFrame(stamp_ns, saved['image_bgr'], saved['depth_m'])


def _spool(frame: RgbdFrame, folder: Path) -> Path:
    path = folder / f'{frame.stamp_ns}.npz'
    np.savez(path, image_bgr=frame.image_bgr, depth_m=frame.depth_m)
    return path
