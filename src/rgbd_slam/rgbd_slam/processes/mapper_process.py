"""The mapper in a process of its own: the tracker never waits for it, and no lock is shared.

The mapper owns the map. Keyframes go to it, and the rows that changed come back and are laid over
the tracker's copy between two frames. That copy is whole: when the process dies, a new one goes on
with it, and only the keyframes under way are lost.
"""

from __future__ import annotations

import logging
from typing import NoReturn

from hoid_common.errors import HoidError
from hoid_common.process.child_process import ChildEndedError, ChildTimeoutError, ChildWorker
from hoid_common.values import FeatureVerdicts, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closing import LoopCounts
from rgbd_slam.mapper import KeyframeRequest
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.map_state import MapState
from rgbd_slam.processes.mapper_worker import (
    Load,
    MapperReport,
    Ready,
    Request,
    Resume,
    Settle,
    Start,
    run_mapper,
)

_START_S = 30.0  # for a new process to load its libraries on a busy machine
_WORK_S = 60.0  # for the longest piece of work, and a new process before it
_SETTLE_S = 20.0  # for adjusting the whole map, in the end

_logger = logging.getLogger(__name__)


class MapperStoppedError(HoidError):
    """The mapping process is gone, or does not answer."""


class MapperProcess:
    """The tracker's end: hands keyframes over and keeps a copy of the map up to date.

    Raises:
        MapperStoppedError: The process does not start; from every method, when it cannot be kept
            running.
    """

    def __init__(self, camera: StereoCamera, atlas: Atlas, config: SlamConfig) -> None:
        self._atlas = atlas
        self.loops = LoopCounts()
        self._num_sent = self._num_done = 0
        self._is_settled = True
        self._worker: ChildWorker[Request, Ready | MapperReport] = ChildWorker(
            'mapper', run_mapper, camera, config
        )
        try:
            self._worker.receive(_START_S)
        except ChildEndedError:
            self._give_up()
        except ChildTimeoutError:
            self._worker.close()
            raise MapperStoppedError(
                f'the mapping process did not start in {_START_S:g} s: the machine is too busy; '
                'free it and start the node again'
            ) from None

    @property
    def num_restarts(self) -> int:
        """Return how often a process that had died was replaced."""
        return self._worker.num_restarts

    @property
    def process_id(self) -> int | None:
        """Return the id of the process."""
        return self._worker.process_id

    @property
    def queue_length(self) -> int:
        """Return how many keyframes wait for the mapper or are being taken in."""
        return self._num_sent - self._num_done

    def start_map(self, frame: Frame, T_map_camera: FloatArray, map_id: int) -> int:
        """Make the first keyframe of a map, wait for it, and return its row."""
        row = None
        while row is None:  # more than once only when the process dies over it
            self._hand_over(Start(frame, T_map_camera, map_id))
            row = self._drain()
        return row

    def insert(self, request: KeyframeRequest) -> int | None:
        """Hand a keyframe over; it will be in the map after some later `update`."""
        self._hand_over(request)
        return None

    def take_back(self, verdicts: FeatureVerdicts) -> None:
        """Have what a keyframe saw forgotten by some later `update`, where it moves after all."""
        self._hand_over(verdicts)

    def load(self, state: MapState, *, keep: bool) -> None:
        """Lay a saved map over the running one, which is kept beside it or gone; waits for it."""
        row = None
        while row is None:
            self._hand_over(Load(state, keep))
            row = self._drain()

    @property
    def is_settled(self) -> bool:
        """Return whether the map stays as it is unless something is handed over."""
        return self.queue_length == 0 and self._is_settled

    def update(self) -> None:
        """Lay what has come over the map."""
        while self._worker.has_report:
            self._take(0.0)

    def settle(self) -> None:
        """Ask for a last adjustment of what has grown; without waiting, see `is_settled`."""
        self._hand_over(Settle(0.0))

    def finish(self) -> None:
        """Wait until everything handed over is in the map, and the whole map is adjusted."""
        self._hand_over(Settle(_SETTLE_S))
        self._drain()
        if not self._is_settled:
            _logger.warning(
                'the whole map is still being adjusted after %g s; what is saved now is the map '
                'before that', _SETTLE_S,
            )  # fmt: skip
        self.update()

    def close(self) -> None:
        """End the process; keyframes still under way are lost."""
        self._worker.close()

    def _hand_over(self, request: Request) -> None:
        self._num_sent += 1
        self._worker.send(request)

    def _drain(self) -> int | None:
        """Wait for all answers and return the last row that one speaks of."""
        row = None
        while self.queue_length:
            row = self._take(_WORK_S)
        return row

    def _take(self, timeout_s: float) -> int | None:
        """Lay the next report over the map and return the row that it speaks of."""
        try:
            report = self._worker.receive(timeout_s)
        except ChildEndedError:
            self._restart()
            return None
        except ChildTimeoutError:
            raise MapperStoppedError(
                f'the mapping process gives no answer in {timeout_s:g} s: the machine is too busy '
                'for it; free it and restart the node'
            ) from None
        if isinstance(report, Ready):
            return None
        self._apply(report)
        return report.row

    def _apply(self, report: MapperReport) -> None:
        self._atlas.apply(report.change)
        self.loops = report.loops
        self._num_done += report.is_answer
        self._is_settled = report.is_settled

    def _restart(self) -> None:
        """Let a new process go on with the map; one that ends before it did anything is not."""
        if self._num_done == 0:
            self._give_up()
        how = self._worker.restart()
        _logger.warning('the mapping process has ended (%s); a new one goes on', how)
        self._num_sent = self._num_done = 0
        self._hand_over(Resume(self._atlas.whole(), self.loops))

    def _give_up(self) -> NoReturn:
        how = self._worker.close()
        raise MapperStoppedError(
            f'the mapping process ends at its start ({how}); see its output above, '
            'mend that and start the node again'
        ) from None
