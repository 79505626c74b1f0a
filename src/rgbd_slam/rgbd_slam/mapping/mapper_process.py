"""The mapper in a separate process, so that tracking does not wait for it or share a lock.

GTSAM holds Python's interpreter lock for 100 to 250 ms (decision 020). The tracker has a complete
copy of the map, with which a new process continues if this one dies. The request in progress is
then lost, unless it starts or loads a map, and so is a running global adjustment. Requests wait in
a queue of the tracker's process, and at most eight are sent ahead, so that waiting keyframes can
be dropped if the mapper is late (`_thin_out`).
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from typing import NoReturn

from hoid_common import se3
from hoid_common.errors import HoidError
from hoid_common.process.child_process import ChildEndedError, ChildTimeoutError, ChildWorker
from hoid_common.values import FeatureVerdicts, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closer import LoopCounts
from rgbd_slam.mapping.map_loading import MapLoading
from rgbd_slam.mapping.mapper import KeyframeRequest
from rgbd_slam.mapping.mapper_worker import (
    Load,
    Loaded,
    MapperReport,
    Ready,
    Request,
    Resume,
    Settle,
    Start,
    run_mapper,
)
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.map_change import Redirect
from rgbd_slam.records.soa_table import DEAD

# Chosen: time limits of many times the usual durations, which are exceeded only on an overloaded
# machine.
_START_S = 30.0  # start of the process, which loads its libraries in about 1 s
_WORK_S = 60.0  # one request, and the start of a replacement process before it
_LOAD_S = 600.0  # longest time to load a map
# Time limit of the global adjustment at the end, which takes 4.7 s for 309 keyframes
# (places_and_loops.md). After it, the map is used without the adjustment, and a warning is logged.
_SETTLE_S = 20.0  # the limit also applies to an adjustment that was running before

# Chosen: number of requests that are sent ahead, so that the process need not wait for the next
# one; and number of queued requests above which waiting keyframes are dropped.
_MAX_SENT = 8
_MAX_QUEUED = 64

_logger = logging.getLogger(__name__)


class MapperStoppedError(HoidError):
    """The mapping process has failed or does not respond, or a map could not be restored."""


class MapperProcess:
    """The tracker's end of the mapping process: sends keyframes, and updates its copy of the map.

    `worker` is the handle of the process (None: start one), and `clock` a monotonic clock in s.
    Methods that receive reports raise MapperStoppedError if the process has ended before it
    completed any request, if a loaded map could not be restored for the tracker, or if a report is
    late.
    """

    def __init__(
        self,
        camera: StereoCamera,
        atlas: Atlas,
        config: SlamConfig,
        *,
        worker: ChildWorker[Request, Ready | MapperReport] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._atlas = atlas
        self.loops = LoopCounts()
        # Requests that are not completed; the first `_num_sent` of them have been sent.
        self._queue: deque[Request] = deque()
        self._num_sent = self._num_done = 0
        # Time at which the process could begin with the first request of the queue.
        self._sent_s = 0.0
        self._is_settled = True
        self._loading: MapLoading | None = None
        # The mapper's report about the map that is being loaded.
        self._loaded: Loaded | None = None
        self._clock = clock
        self._worker = worker or ChildWorker('mapper', run_mapper, camera, config)
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
        return self._worker.num_restarts

    @property
    def queue_length(self) -> int:
        """Return the number of requests that are not known to be completed."""
        return len(self._queue)

    @property
    def waiting_s(self) -> float:
        """Return for how long (s) the process has been working on the first queued request.

        It is 0 if no request is queued.
        """
        return self._clock() - self._sent_s if self._queue else 0.0

    @property
    def is_settled(self) -> bool:
        """Return whether no request is queued and, as last reported, no adjustment runs."""
        return self.queue_length == 0 and self._is_settled

    def start_map(self, uid: int, frame: Frame, T_map_camera: FloatArray, map_id: int) -> None:
        self._atlas.pending[uid] = Redirect(uid, DEAD, T_map_camera)
        self._append(Start(uid, frame, T_map_camera, map_id))

    def insert(self, request: KeyframeRequest) -> None:
        """Queue a keyframe, which is pending until it is in the tracker's map.

        It is dropped if the mapper cannot insert it, or if too many requests are queued
        (`_thin_out`). Poses relative to it then become relative to its reference keyframe.
        """
        tracked = request.tracked
        T_reference_camera = se3.orthonormalized(tracked.T_reference_camera)
        self._atlas.pending[request.uid] = Redirect(
            request.uid, tracked.reference_uid, T_reference_camera
        )
        self._append(request)

    def retract(self, verdicts: FeatureVerdicts) -> None:
        self._append(verdicts)

    def begin_load(self, loading: MapLoading) -> None:
        """Request the loading of a saved map; later requests apply to the new map.

        If the running map is kept, the mapper must be settled, so that both processes add the
        saved map to the same running one.
        """
        self._loading = loading
        self._append(loading.request())

    def finish_load(self, loading: MapLoading) -> None:
        loading.restore()
        self.wait(_LOAD_S)

    @property
    def is_loading(self) -> bool:
        return self._loading is not None

    def update(self) -> None:
        """Apply the arrived reports to the tracker's map, or exchange it for a loaded one.

        If the mapper has loaded a map that the tracker has not restored yet, later reports wait
        for a later call. A process that has died is replaced.
        """
        while self._adopt(0.0) and self._worker.has_report:
            self._receive(0.0)

    def settle(self) -> None:
        """Request a final global adjustment (`LoopCloser.settle`); then wait for `is_settled`."""
        self._append(Settle(0.0))

    def wait(self, limit_s: float = _WORK_S) -> None:
        """Wait until all queued requests are completed, at most `limit_s` for each report."""
        while self._queue:
            self._receive(limit_s)
            self._adopt(limit_s)

    def finish(self) -> None:
        """Wait for the end of all requests and of a final global adjustment (`settle`).

        The process waits at most 20 s for a running adjustment, and as long for the final one. If
        an adjustment still runs then, a warning is logged.
        """
        self._append(Settle(_SETTLE_S))
        self.wait()
        if not self._is_settled:
            _logger.warning(
                'the global adjustment of the map has not ended within %g s; the map that is '
                'saved now lacks it',
                _SETTLE_S,
            )
        self.update()

    def close(self) -> None:
        self._worker.close()

    def _append(self, request: Request) -> None:
        self._queue.append(request)
        if len(self._queue) > _MAX_QUEUED:
            self._thin_out()
        self._send_ahead()

    def _send_ahead(self) -> None:
        """Send requests until the process has eight uncompleted ones, or all of them."""
        while self._num_sent < min(_MAX_SENT, len(self._queue)):
            request = self._queue[self._num_sent]
            if isinstance(request, KeyframeRequest):
                request = self._reattached(request)
            if self._num_sent == 0:
                self._sent_s = self._clock()
            self._num_sent += 1
            self._worker.send(request)

    def _reattached(self, request: KeyframeRequest) -> KeyframeRequest:
        """Return a request whose reference keyframe the process has or is about to insert."""
        tracked = request.tracked
        uid, T_reference_camera = tracked.reference_uid, tracked.T_reference_camera
        while self._atlas.keyframes.index_of(uid) is None and uid not in self._atlas.pending:
            redirect = self._atlas.redirects.find(uid)
            if redirect is None:
                return request
            uid = redirect.parent_uid
            T_reference_camera = redirect.T_parent_camera @ T_reference_camera
        tracked = replace(tracked, reference_uid=uid, T_reference_camera=T_reference_camera)
        return replace(request, tracked=tracked)

    def _thin_out(self) -> None:
        """Remove every second unsent keyframe from the queue.

        The remaining keyframes overlap less, but usually enough to be connected with each other.
        """
        waiting = list(islice(self._queue, self._num_sent, None))
        keyframes = [request for request in waiting if isinstance(request, KeyframeRequest)]
        dropped = {request.uid for request in keyframes[::2]}
        for uid in dropped:
            self._atlas.drop_pending(uid)
        sent = list(islice(self._queue, self._num_sent))
        self._queue = deque(
            request
            for request in [*sent, *waiting]
            if not (isinstance(request, KeyframeRequest) and request.uid in dropped)
        )

    def _receive(self, timeout_s: float) -> None:
        """Wait for the next report and apply it; replace a process that has died."""
        try:
            report = self._worker.receive(timeout_s)
        except ChildEndedError:
            self._restart()
            return
        except ChildTimeoutError:
            raise MapperStoppedError(
                f'the mapping process did not respond within {timeout_s:g} s because the machine '
                'is too busy; free it and restart the node'
            ) from None
        if isinstance(report, Ready):
            return
        request = self._queue[0] if report.completes_request else None
        frame = None  # a keyframe's features are not sent back
        if isinstance(request, Start):
            frame = request.frame
        elif isinstance(request, KeyframeRequest):
            frame = request.tracked.frame
        if isinstance(report.change, Loaded):
            self._loaded = report.change
        else:
            self._atlas.apply(report.change, frame)
        self.loops = report.loops
        self._is_settled = report.is_settled
        if report.completes_request:
            self._complete_request()

    def _adopt(self, limit_s: float) -> bool:
        """Exchange the tracker's map for a loaded map, once the mapper has loaded it too.

        Wait up to `limit_s` until the map is restored for the tracker. Return whether further
        reports may be applied: False while a loaded map is not restored yet.
        """
        loaded, loading = self._loaded, self._loading
        if loaded is None or loading is None:
            return True
        if not loading.wait(limit_s):
            return False
        if loading.atlas is None:
            raise MapperStoppedError('the map that was being loaded could not be restored')
        self._atlas.adopt(loading.atlas, *loaded, keep_pending=loading.keeps_running)
        self._loaded = self._loading = None
        return True

    def _complete_request(self) -> None:
        request = self._queue.popleft()
        self._num_sent -= 1
        self._num_done += 1
        self._sent_s = self._clock()
        if isinstance(request, KeyframeRequest):
            self._atlas.drop_pending(request.uid)  # in case the mapper could not insert it
        self._send_ahead()

    def _restart(self) -> None:
        """Replace the process; the new one continues with the tracker's copy of the map.

        The request in progress is not sent again, because it may have caused the failure, except
        `Start` and `Load`, without which a map would be missing.
        """
        if self._num_done == 0:
            self._give_up()
        how = self._worker.restart()
        _logger.warning('the mapping process has ended (%s); a new one continues its map', how)
        if self._queue and not isinstance(self._queue[0], Start | Load):
            lost = self._queue.popleft()
            if isinstance(lost, KeyframeRequest):
                self._atlas.drop_pending(lost.uid)
        self._queue.appendleft(Resume(self._atlas.whole(), self.loops))
        self._num_sent = self._num_done = 0
        self._send_ahead()

    def _give_up(self) -> NoReturn:
        how = self._worker.close()
        raise MapperStoppedError(
            f'the mapping process ends at its start ({how}); see its output above, '
            'fix the cause and start the node again'
        ) from None
