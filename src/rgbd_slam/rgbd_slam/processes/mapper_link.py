"""How the tracker hands keyframes to a mapper, wherever that runs."""

from __future__ import annotations

from typing import Protocol

from hoid_common.values import FeatureVerdicts, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closing import LoopCounts
from rgbd_slam.mapper import KeyframeRequest, Mapper
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.map_state import MapState


class MapperLink(Protocol):
    """What the tracker needs of a mapper; the map it sees changes in these calls only."""

    @property
    def loops(self) -> LoopCounts:
        """Return how many loops were closed, and maps merged."""
        ...

    @property
    def num_restarts(self) -> int:
        """Return how often a mapper that had died was replaced."""
        ...

    @property
    def queue_length(self) -> int:
        """Return how many keyframes wait for the mapper or are being taken in."""
        ...

    def start_map(self, frame: Frame, T_map_camera: FloatArray, map_id: int) -> int:
        """Make the first keyframe of a map and return its row."""
        ...

    def insert(self, request: KeyframeRequest) -> int | None:
        """Hand a keyframe over; its row when that has been taken in at once."""
        ...

    def take_back(self, verdicts: FeatureVerdicts) -> None:
        """Forget what a keyframe saw on what turned out to move."""
        ...

    @property
    def is_settled(self) -> bool:
        """Return whether the map stays as it is unless something is handed over."""
        ...

    def load(self, state: MapState, *, keep: bool) -> None:
        """Lay a saved map over the running one, which is kept beside it or gone."""
        ...

    def update(self) -> None:
        """Bring the map up to date, without waiting."""
        ...

    def settle(self) -> None:
        """Ask for a last adjustment of what has grown; without waiting, see `is_settled`."""
        ...

    def finish(self) -> None:
        """Wait until everything handed over is in the map and has settled there."""
        ...

    def close(self) -> None:
        """End what runs in the background."""
        ...


class InlineMapper:
    """A mapper that does its work at once, so that runs repeat bit for bit."""

    queue_length = 0
    num_restarts = 0
    is_settled = True

    def __init__(self, camera: StereoCamera, atlas: Atlas, config: SlamConfig) -> None:
        self._mapper = Mapper(camera, atlas, config)

    @property
    def loops(self) -> LoopCounts:
        """Return how many loops were closed, and maps merged."""
        return self._mapper.loops

    def start_map(self, frame: Frame, T_map_camera: FloatArray, map_id: int) -> int:
        """Make the first keyframe of a map and return its row."""
        return self._mapper.start_map(frame, T_map_camera, map_id)

    def insert(self, request: KeyframeRequest) -> int | None:
        """Take a keyframe in and return its row."""
        return self._mapper.insert(request)

    def take_back(self, verdicts: FeatureVerdicts) -> None:
        """Forget what a keyframe saw on what turned out to move."""
        self._mapper.take_back(verdicts)

    def load(self, state: MapState, *, keep: bool) -> None:
        """Lay a saved map over the running one, which is kept beside it or gone."""
        self._mapper.load(state, keep=keep)

    def update(self) -> None:
        """Do nothing: the map is up to date."""

    def settle(self) -> None:
        """Adjust what has grown once more, at once."""
        self._mapper.settle(0.0)

    def finish(self) -> None:
        """Let the map settle."""
        self.settle()

    def close(self) -> None:
        """End what runs in the background."""
        self._mapper.close()
