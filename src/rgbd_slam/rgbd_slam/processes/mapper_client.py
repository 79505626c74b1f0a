"""The interface through which the tracker uses a mapper, in this process or in another one."""

from __future__ import annotations

from typing import Protocol

from hoid_common.values import FeatureVerdicts, FloatArray
from rgbd_slam.loops.loop_closer import LoopCounts
from rgbd_slam.mapper import KeyframeRequest, Mapper
from rgbd_slam.model.frame import Frame
from rgbd_slam.model.map_state import MapState
from rgbd_slam.processes.map_loading import MapLoading


class MapperClient(Protocol):
    """The mapper as the tracker uses it. The tracker's map changes during these calls only."""

    @property
    def loops(self) -> LoopCounts:
        """Return the numbers of loops closed and of maps merged so far."""

    @property
    def num_restarts(self) -> int:
        """Return how often a mapping process died and was replaced."""

    @property
    def queue_length(self) -> int:
        """Return the number of requests that the mapper has not completed yet."""

    @property
    def waiting_s(self) -> float:
        """Return the time [s] that the mapper has been working on its present request.

        It is 0 if the mapper has nothing to do.
        """

    @property
    def is_settled(self) -> bool:
        """Return whether the map will stay as it is until the next request."""

    def start_map(self, uid: int, frame: Frame, T_map_camera: FloatArray, map_id: int) -> object:
        """Request the first keyframe of a new map, with the pose T_map_camera (4, 4).

        The keyframe is in the `pending` of the tracker's map until the mapper has created it.
        """

    def insert(self, request: KeyframeRequest) -> object:
        """Request the insertion of a keyframe.

        The keyframe is in the `pending` of the tracker's map until the mapper has inserted it.
        """

    def retract(self, verdicts: FeatureVerdicts) -> None:
        """Request to remove the observations of a keyframe's features that are dynamic.

        Args:
            verdicts: Which features of the keyframe with this stamp turned out to be dynamic.
        """

    def load(self, state: MapState, first_uid: int, *, keep: bool) -> None:
        """Load a saved map, and wait until it is loaded.

        Args:
            state: The saved map.
            first_uid: Uid of its first keyframe; the others get the next ones.
            keep: True: keep the running map beside it. False: discard the running map.

        Raises:
            MapperStoppedError: The process of the mapper does not respond.
        """

    def begin_load(self, loading: MapLoading, first_uid: int) -> None:
        """Start to replace the running map by a saved one, without waiting for the end.

        Once both the mapper and the other thread have restored it, the next `update` replaces the
        tracker's map.

        Args:
            loading: The saved map, which another thread restores for the tracker.
            first_uid: Uid of its first keyframe; the others get the next ones.
        """

    @property
    def is_loading(self) -> bool:
        """Return whether `begin_load` was called and has not replaced the tracker's map yet."""

    def update(self) -> None:
        """Apply the changes that the mapper has finished to the tracker's map, without waiting."""

    def settle(self) -> None:
        """Request a final global adjustment; poll `is_settled` for its end.

        It repeats the last global adjustment if keyframes have been added to the map since then;
        see `LoopCloser.settle`.
        """

    def finish(self) -> None:
        """Do the same as `settle`, then wait until all requests and the adjustment have ended."""

    def close(self) -> None:
        """Stop background work; the tracker's map stays readable.

        Requests that wait may be lost; `finish` completes them first.
        """


class InlineMapper(Mapper):
    """A mapper that completes each request before the call returns: runs are repeatable."""

    queue_length = 0
    waiting_s = 0.0
    num_restarts = 0
    is_settled = True
    is_loading = False

    def begin_load(self, loading: MapLoading, first_uid: int) -> None:
        """Replace the running map by the saved one before the call returns."""
        self.load(loading.state, first_uid, keep=False)

    def update(self) -> None:
        """Do nothing: the tracker and the mapper share one map."""

    def settle(self) -> None:
        """Repeat the last global adjustment if keyframes have been added to the map since then."""
        self.finish_adjustment(0.0)

    def finish(self) -> None:
        """Do the same as `settle`: nothing is left to wait for."""
        self.settle()
