"""A mapping process in virtual time: its reports arrive a chosen time after the requests.

Time passes only from image to image, so that the load of the machine changes nothing. The
tracker's end of the mapping process, with its queue, is the product's own; only the child process
behind it is replaced. Everything that the benchmark needs to know of the interface between
tracker and mapper is in this file.
"""

from __future__ import annotations

import math
import pickle
import time
from collections import deque
from dataclasses import dataclass
from typing import Any, NamedTuple
from unittest.mock import patch

from hoid_common.process.child_process import ChildTimeoutError
from hoid_common.values import NS_PER_S
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops import global_adjustment
from rgbd_slam.mapping.mapper import KeyframeRequest
from rgbd_slam.mapping.mapper_process import MapperProcess
from rgbd_slam.mapping.mapper_worker import MapperReport, MapperServer, Ready, Request
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.session import SlamSession

_NEVER_S = math.inf
_PROTOCOL = pickle.HIGHEST_PROTOCOL
_solve = global_adjustment.solve


@dataclass(frozen=True)
class Delay:
    """How late the mapper reports. Reports keep their order."""

    constant_s: float = 0.0  # a report is never earlier than the image after its request
    stall_s: float = 0.0  # delay of the first keyframe from `stall_at_s` on
    stall_at_s: float = _NEVER_S
    # Each request also takes its own CPU time, multiplied by this. The time of global adjustments
    # is not counted, which the product solves in a process of their own.
    cpu_factor: float = 0.0


class Answer(NamedTuple):
    """What one keyframe cost, and when its changes reached the tracker."""

    request_s: float  # stamp of the image at which it was sent
    answer_s: float  # stamp of the first image that used the changes
    cpu_ms: float  # CPU time of the mapper
    num_bytes: int  # of the report that was sent to the tracker
    num_keyframes: int  # in the map
    is_stalled: bool


class _Report(NamedTuple):
    due_s: float
    report: bytes
    answer: Answer | None  # None: not of a keyframe


class VirtualWorker:
    """Replaces the `ChildWorker` of the mapping process by a mapper with a map of its own.

    Args:
        camera: The camera with its configured noise.
        config: Parameters of the core.
        delay: How late the mapper reports.
    """

    num_restarts = 0

    def __init__(self, camera: StereoCamera, config: SlamConfig, delay: Delay) -> None:
        self._server = MapperServer(camera, config, background=False)
        self._delay = delay
        self.now_s = self._last_due_s = 0.0
        self._has_stalled = False
        self._solving_s = 0.0  # CPU time of global adjustments in the present request
        self._requests: deque[tuple[float, bytes]] = deque()
        self._reports = deque([_Report(0.0, pickle.dumps(Ready(), _PROTOCOL), None)])
        self.answers: list[Answer] = []  # that have reached the tracker

    def proceed(self, stamp_ns: int) -> None:
        """Proceed to the image with this stamp: serve the requests that were sent before it."""
        self.now_s = stamp_ns / NS_PER_S
        self.serve_all()

    # ---- the interface of `ChildWorker`

    def send(self, request: Request) -> None:
        """Queue a request, as bytes, so that tracker and mapper share no memory."""
        self._requests.append((self.now_s, pickle.dumps(request, _PROTOCOL)))

    @property
    def has_report(self) -> bool:
        """Return whether a report is due."""
        return bool(self._reports) and self._reports[0].due_s <= self.now_s

    def receive(self, timeout_s: float) -> Ready | MapperReport:
        """Return the next report; a caller that waits gets it in no time.

        Raises:
            ChildTimeoutError: No report is due, and the caller does not wait.
        """
        if timeout_s > 0:
            self.serve_all()
        elif not self.has_report:
            raise ChildTimeoutError('no report is due')
        due = self._reports.popleft()
        if due.answer is not None:
            self.answers.append(due.answer._replace(answer_s=self.now_s))
        report: Ready | MapperReport = pickle.loads(due.report)  # noqa: S301  our own
        return report

    def restart(self) -> str:
        """Raise an error, because a mapper in this process cannot have died.

        Raises:
            NotImplementedError: Always.
        """
        raise NotImplementedError

    def close(self) -> str:
        """End the mapper."""
        self._server.close()
        return 'exit code 0'

    def serve_all(self) -> None:
        """Serve all requests that were sent."""
        while self._requests:
            self._reports.append(self._serve(*self._requests.popleft()))

    def _serve(self, request_s: float, request: bytes) -> _Report:
        """Serve a request at once, and determine when the tracker gets the report."""
        content: Request = pickle.loads(request)  # noqa: S301  our own
        start_s, self._solving_s = time.process_time(), 0.0
        with patch.object(global_adjustment, 'solve', self._timed_solve):
            report = pickle.dumps(self._server.serve(content), _PROTOCOL)
        cpu_s = time.process_time() - start_s - self._solving_s
        is_keyframe = isinstance(content, KeyframeRequest)
        is_stalled = is_keyframe and not self._has_stalled and request_s >= self._delay.stall_at_s
        self._has_stalled |= is_stalled
        latency_s = self._delay.stall_s if is_stalled else self._delay.constant_s
        due_s = max(request_s + latency_s, self._last_due_s) + self._delay.cpu_factor * cpu_s
        self._last_due_s = due_s
        num_keyframes = len(self._server.map.keyframes)
        answer = Answer(request_s, due_s, 1e3 * cpu_s, len(report), num_keyframes, is_stalled)
        return _Report(due_s, report, answer if is_keyframe else None)

    def _timed_solve(self, *arguments: Any) -> Any:
        start_s = time.process_time()
        solution = _solve(*arguments)
        self._solving_s += time.process_time() - start_s
        return solution


def with_virtual_mapper(session: SlamSession, config: SlamConfig, delay: Delay) -> VirtualWorker:
    """Replace the mapper of a session that has not started yet."""
    camera = StereoCamera.from_model(session.camera, config.camera)
    worker = VirtualWorker(camera, config, delay)
    child: Any = worker
    session.map.mapper = MapperProcess(
        camera, session.map.atlas, config, worker=child, clock=lambda: worker.now_s
    )
    return worker
