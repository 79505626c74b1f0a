"""The mapper in a separate process: tracking never waits for it, and no lock is shared.

The reason is GTSAM, which holds Python's interpreter lock for 100 to 250 ms (decision 020). The
mapping process owns the map. The tracker sends it keyframes, receives the rows that changed, and
applies these to its own copy between two frames. That copy is complete: when the process dies, a
new one continues with it, and only the keyframes that were queued are lost.
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

# Chosen: many times the usual durations, so that they expire only on a machine that is overloaded.
_START_S = 30.0  # a new process loads its libraries in about 1 s
_WORK_S = 60.0  # the longest request, and the start of a replacement process before it
_SETTLE_S = 20.0  # global adjustment at the end; 4.7 s for 309 keyframes (places_and_loops.md)

_logger = logging.getLogger(__name__)


class MapperStoppedError(HoidError):
    """The mapping process has ended for good, or does not respond."""


class MapperProcess:
    """The tracker's end: sends keyframes and keeps its copy of the map up to date.

    Raises:
        MapperStoppedError: The process does not start. Every method raises it as well, once the
            process cannot be kept running.
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
                f'the mapping process did not start within {_START_S:g} s because the machine is '
                'too busy; free it and start the node again'
            ) from None

    @property
    def num_restarts(self) -> int:
        """Return how often the process died and was replaced."""
        return self._worker.num_restarts

    @property
    def queue_length(self) -> int:
        """Return the number of requests that the process has not completed yet."""
        return self._num_sent - self._num_done

    @property
    def is_settled(self) -> bool:
        """Return whether the map will stay as it is until the next request."""
        return self.queue_length == 0 and self._is_settled

    def start_map(self, frame: Frame, T_map_camera: FloatArray, map_id: int) -> int:
        """Create the first keyframe of a map, wait for it, and return its row."""
        return self._wait_for_row(Start(frame, T_map_camera, map_id))

    def insert(self, request: KeyframeRequest) -> int | None:
        """Queue a keyframe; a later `update` brings it into the tracker's map."""
        self._send(request)
        return None

    def retract(self, verdicts: FeatureVerdicts) -> None:
        """Queue the removal of the observations of a keyframe's dynamic features."""
        self._send(verdicts)

    def load(self, state: MapState, *, keep: bool) -> int:
        """Load a saved map, wait for it, and return the row of its first keyframe."""
        return self._wait_for_row(Load(state, keep))

    def update(self) -> None:
        """Apply the reports that have arrived to the tracker's map."""
        while self._worker.has_report:
            self._receive(0.0)

    def settle(self) -> None:
        """Request a final adjustment of the whole map; poll `is_settled` for its end."""
        self._send(Settle(0.0))

    def wait(self) -> int | None:
        """Wait until the queue is empty; return the row that the last report names, if any."""
        row = None
        while self.queue_length:
            row = self._receive(_WORK_S)
        return row

    def finish(self) -> None:
        """Wait until the queue is empty and the whole map has been adjusted."""
        self._send(Settle(_SETTLE_S))
        self.wait()
        if not self._is_settled:
            _logger.warning(
                'the global adjustment of the map has not ended within %g s; the map that is '
                'saved now lacks it',
                _SETTLE_S,
            )
        self.update()

    def close(self) -> None:
        """End the process; queued keyframes are lost."""
        self._worker.close()

    def _send(self, request: Request) -> None:
        self._num_sent += 1
        self._worker.send(request)

    def _wait_for_row(self, request: Start | Load) -> int:
        """Send a request until it is completed: again only when the process died over it."""
        row = None
        while row is None:
            self._send(request)
            row = self.wait()
        return row

    def _receive(self, timeout_s: float) -> int | None:
        """Apply the next report to the map and return the row that it names, if any."""
        try:
            report = self._worker.receive(timeout_s)
        except ChildEndedError:
            self._restart()
            return None
        except ChildTimeoutError:
            raise MapperStoppedError(
                f'the mapping process did not respond within {timeout_s:g} s because the machine '
                'is too busy; free it and restart the node'
            ) from None
        if isinstance(report, Ready):
            return None
        self._atlas.apply(report.change)
        self.loops = report.loops
        self._num_done += report.completes_request
        self._is_settled = report.is_settled
        return report.row

    def _restart(self) -> None:
        """Replace the process, unless it ended before it completed a single request."""
        if self._num_done == 0:
            self._give_up()
        how = self._worker.restart()
        _logger.warning('the mapping process has ended (%s); a new one continues its map', how)
        self._num_sent = self._num_done = 0
        self._send(Resume(self._atlas.whole(), self.loops))

    def _give_up(self) -> NoReturn:
        how = self._worker.close()
        raise MapperStoppedError(
            f'the mapping process ends at its start ({how}); see its output above, '
            'fix the cause and start the node again'
        ) from None
