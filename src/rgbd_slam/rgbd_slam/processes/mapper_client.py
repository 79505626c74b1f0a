"""The interface through which the tracker uses a mapper, in this process or in another one."""

from __future__ import annotations

from typing import Protocol

from hoid_common.values import FeatureVerdicts, FloatArray
from rgbd_slam.loops.loop_closer import LoopCounts
from rgbd_slam.mapper import KeyframeRequest, Mapper
from rgbd_slam.model.frame import Frame
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
        """Return the number of requests that are not known to be completed.

        Calls of `update` receive the reports of completed requests.
        """

    @property
    def waiting_s(self) -> float:
        """Return the time [s] since the mapper began the oldest request of `queue_length`.

        It is 0 if there is no such request.
        """

    @property
    def is_settled(self) -> bool:
        """Return whether no request is left and no global adjustment is running.

        The map then stays as it is until the next request, unless `is_loading` is True.
        """

    def start_map(self, uid: int, frame: Frame, T_map_camera: FloatArray, map_id: int) -> object:
        """Request the first keyframe of a new map, with the pose T_map_camera (4, 4).

        The keyframe is in the `pending` of the tracker's map until the mapper has created it.
        """

    def insert(self, request: KeyframeRequest) -> object:
        """Request the insertion of a keyframe.

        The keyframe is in the `pending` of the tracker's map until the mapper has inserted it, or
        until it is dropped: because too many requests wait, or because the mapper could not insert
        it. Poses relative to a dropped keyframe become relative to its reference keyframe.
        """

    def retract(self, verdicts: FeatureVerdicts) -> None:
        """Request to remove the observations of a keyframe's features that are dynamic.

        Verdicts on an image that is no keyframe have no effect.

        Args:
            verdicts: Which features of the keyframe with this stamp turned out to be dynamic.
        """

    def begin_load(self, loading: MapLoading, first_uid: int) -> None:
        """Start to load a saved map, without waiting for the end.

        Once both the mapper and the other thread have restored it, the next `update` exchanges the
        tracker's map. If the running map is kept, the mapper must be settled (`is_settled`), so
        that both restore the saved map beside the same running one.

        Args:
            loading: The saved map, which another thread restores for the tracker.
            first_uid: Uid of its first keyframe; the others get the next ones.
        """

    def finish_load(self, loading: MapLoading, first_uid: int) -> None:
        """Restore the map of `begin_load` for the tracker, and wait until the mapper has it too.

        Raises:
            MapperStoppedError: The process of the mapper takes too long, or cannot be kept
                running, or the map could not be restored.
        """

    @property
    def is_loading(self) -> bool:
        """Return whether `begin_load` was called and has not exchanged the tracker's map yet."""

    def update(self) -> None:
        """Apply the changes that the mapper has finished to the tracker's map, without waiting.

        Raises:
            MapperStoppedError: The process of the mapper cannot be kept running, or the map that
                was being loaded could not be restored.
        """

    def settle(self) -> None:
        """Request a final global adjustment; poll `is_settled` for its end.

        It repeats the last global adjustment if keyframes have been added to its map since then,
        and if no adjustment is running; see `LoopCloser.settle`.
        """

    def finish(self) -> None:
        """Wait for the end of all requests, and of a final global adjustment as in `settle`.

        A mapper in a separate process waits for the adjustment up to a time limit only.

        Raises:
            MapperStoppedError: The process of the mapper takes too long, or cannot be kept
                running.
        """

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
        """Load the saved map before the call returns."""
        self.load(loading.state, first_uid, keep=loading.keeps_running, loops=loading.loops)

    def finish_load(self, loading: MapLoading, first_uid: int) -> None:
        """Do nothing: the map is loaded already."""

    def update(self) -> None:
        """Do nothing: the tracker and the mapper share one map."""

    def settle(self) -> None:
        """Repeat the last global adjustment if keyframes have been added to the map since then."""
        self.finish_adjustment(0.0)

    def finish(self) -> None:
        """Do the same as `settle`: nothing is left to wait for."""
        self.settle()
