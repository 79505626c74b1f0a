"""The interface through which the tracker uses a mapper, in this process or in another one."""

from __future__ import annotations

from typing import Protocol

from hoid_common.values import FeatureVerdicts, FloatArray
from rgbd_slam.loops.loop_closing import LoopCounts
from rgbd_slam.mapper import KeyframeRequest, Mapper
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.map_state import MapState


class MapperClient(Protocol):
    """The tracker's end of a mapper. The tracker's map changes during these calls only."""

    @property
    def loops(self) -> LoopCounts:
        """Return the number of closed loops and of merged maps."""

    @property
    def num_restarts(self) -> int:
        """Return how often a mapping process died and was replaced."""

    @property
    def queue_length(self) -> int:
        """Return the number of requests that the mapper has not completed yet."""

    @property
    def waiting_s(self) -> float:
        """Return the time [s] since the mapper should have answered a request, else 0."""

    @property
    def is_settled(self) -> bool:
        """Return whether the map will stay as it is until the next request."""

    def start_map(self, uid: int, frame: Frame, T_map_camera: FloatArray, map_id: int) -> object:
        """Create the first keyframe of a map; it is pending in the tracker's map until then."""

    def insert(self, request: KeyframeRequest) -> object:
        """Insert a keyframe; it is pending in the tracker's map until then."""

    def retract(self, verdicts: FeatureVerdicts) -> None:
        """Remove the observations of a keyframe's features that proved dynamic."""

    def load(self, state: MapState, first_uid: int, *, keep: bool) -> None:
        """Load a saved map; `keep` the running one beside it, or discard that."""

    def update(self) -> None:
        """Apply finished changes to the tracker's map, without waiting."""

    def settle(self) -> None:
        """Request a final adjustment of the whole map; poll `is_settled` for its end."""

    def finish(self) -> None:
        """Wait until all requests are completed and the whole map has been adjusted."""

    def close(self) -> None:
        """Stop background work; the tracker's map stays readable."""


class InlineMapper(Mapper):
    """A mapper that completes each request before the call returns, so that runs repeat."""

    queue_length = 0
    waiting_s = 0.0
    num_restarts = 0
    is_settled = True

    def update(self) -> None:
        """Do nothing: the tracker and the mapper share one map."""

    def settle(self) -> None:
        """Adjust the part of the map that has grown since the last adjustment."""
        self.finish_adjustment(0.0)

    def finish(self) -> None:
        """Do the same as `settle`: nothing is left to wait for."""
        self.settle()
