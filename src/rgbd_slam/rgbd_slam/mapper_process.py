"""The mapper in a process of its own: the tracker never waits for it, and no lock is shared.

The mapper owns the map. Keyframes go to it, and the rows that changed come back and are laid over
the tracker's copy between two frames. Two threads of the tracker's process move the bytes; what
they share with it are queues. The process ends when the pipe from the tracker does, so that it
outlives neither `close` nor a killed tracker.
"""

from __future__ import annotations

import atexit
import signal
from collections import deque
from multiprocessing import get_context
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from threading import Thread
from typing import NamedTuple

from hoid_common.errors import HoidError
from hoid_common.values import FloatArray
from rgbd_slam.config import SlamConfig
from rgbd_slam.frame import Frame, StereoCamera
from rgbd_slam.loop_closing import LoopCounts
from rgbd_slam.map import MapChange, Redirect, SlamMap
from rgbd_slam.mapper import KeyframeRequest, Mapper

_IDLE_S = 0.2  # between looks for results of the background
_START_S = 60.0  # for a new process to load its libraries on a busy machine
_WORK_S = 30.0  # for the longest piece of work
_END_S = 5.0


class MapperStoppedError(HoidError):
    """The mapping process is gone."""


class _Start(NamedTuple):
    frame: Frame
    T_map_camera: FloatArray  # (4, 4)
    map_id: int


_Request = _Start | KeyframeRequest


class _Report(NamedTuple):
    """What the mapper sends after each request, and after changes of its own."""

    change: MapChange
    row: int | None  # of the keyframe that a request made
    loops: LoopCounts
    is_answer: bool


def run_mapper(
    requests: Connection, reports: Connection, camera: StereoCamera, config: SlamConfig
) -> None:
    """Take keyframes in until the pipe ends; the main function of the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all: the tracker ends this
    slam_map = SlamMap(config.camera.scale_factor, config.camera.num_octaves)
    mapper = Mapper(camera, slam_map, config, background=True)
    version = 0
    reports.send(None)  # ready
    try:
        while True:
            is_answer, row = requests.poll(_IDLE_S), None
            if is_answer:
                row = _do(mapper, requests.recv())
            elif not mapper.poll():
                continue
            change = slam_map.changes_since(version)
            version = change.version
            reports.send(_Report(change, row, mapper.loops, is_answer))
    except (EOFError, BrokenPipeError):
        pass  # the tracker has ended
    finally:
        mapper.close()


def _do(mapper: Mapper, request: _Request) -> int | None:
    if isinstance(request, KeyframeRequest):
        return mapper.insert(request)
    return mapper.start_map(*request)


class MapperProcess:
    """The tracker's end: hands keyframes over and keeps a copy of the map up to date.

    Raises:
        MapperStoppedError: The process does not start; from every method, when it has ended.
    """

    def __init__(self, camera: StereoCamera, slam_map: SlamMap, config: SlamConfig) -> None:
        self._map = slam_map
        self.loops = LoopCounts()
        self._num_sent = self._num_done = 0
        self._to_send: SimpleQueue[_Request | None] = SimpleQueue()
        self._received: SimpleQueue[_Report | None] = SimpleQueue()
        self._redirects: deque[Redirect] = deque()
        context = get_context('spawn')
        request_reader, self._requests = context.Pipe(duplex=False)
        self._reports, report_writer = context.Pipe(duplex=False)
        self._process = context.Process(
            target=run_mapper, args=(request_reader, report_writer, camera, config), name='mapper'
        )
        self._process.start()
        request_reader.close()
        report_writer.close()
        atexit.register(self.close)  # before multiprocessing waits for the process
        self._sender = Thread(target=self._send, name='to mapper', daemon=True)
        self._receiver = Thread(target=self._receive, name='from mapper', daemon=True)
        self._await_start()

    def _await_start(self) -> None:
        try:
            ready = self._reports.poll(_START_S)
            if ready:
                self._reports.recv()
        except EOFError:
            ready = False
        if not ready:
            self.close()
            raise MapperStoppedError('the mapping process does not start; see its output above')
        self._sender.start()
        self._receiver.start()

    @property
    def process_id(self) -> int | None:
        """Return the id of the process."""
        return self._process.pid

    @property
    def queue_length(self) -> int:
        """Return how many keyframes wait for the mapper or are being taken in."""
        return self._num_sent - self._num_done

    def start_map(self, frame: Frame, T_map_camera: FloatArray, map_id: int) -> int:
        """Make the first keyframe of a map, wait for it, and return its row."""
        self._hand_over(_Start(frame, T_map_camera, map_id))
        row = None
        while self.queue_length:
            row = self._take(_WORK_S)
        assert row is not None
        return row

    def insert(self, request: KeyframeRequest) -> int | None:
        """Hand a keyframe over; it will be in the map after some later `update`."""
        self._hand_over(request)
        return None

    def update(self) -> tuple[Redirect, ...]:
        """Lay what has come over the map and say what became of old keyframes."""
        while not self._received.empty():
            self._take(0.0)
        redirects = tuple(self._redirects)
        self._redirects.clear()
        return redirects

    def finish(self) -> tuple[Redirect, ...]:
        """Wait until everything handed over is in the map."""
        while self.queue_length:
            self._take(_WORK_S)
        return self.update()

    def close(self) -> None:
        """End the process; keyframes still under way are lost."""
        atexit.unregister(self.close)
        self._to_send.put(None)
        if self._sender.is_alive():
            self._sender.join(_END_S)
        self._requests.close()
        self._process.join(_END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        if self._receiver.is_alive():
            self._receiver.join(_END_S)
        self._reports.close()

    def _hand_over(self, request: _Request) -> None:
        self._num_sent += 1
        self._to_send.put(request)

    def _take(self, timeout_s: float) -> int | None:
        """Lay the next report over the map and return the row that it speaks of."""
        try:
            report = self._received.get(timeout=timeout_s)
        except Empty:
            report = None
        if report is None:
            self._received.put(None)  # so that later calls see it too
            code = self._process.exitcode
            raise MapperStoppedError(
                f'the mapping process has stopped (exit code {code}); restart the node'
            )
        self._map.apply(report.change)
        self._redirects.extend(self._map.take_redirects())
        self.loops = report.loops
        self._num_done += report.is_answer
        return report.row

    def _send(self) -> None:
        try:
            while (request := self._to_send.get()) is not None:
                self._requests.send(request)
        except (BrokenPipeError, OSError):
            pass  # the receiver says so

    def _receive(self) -> None:
        try:
            while True:
                self._received.put(self._reports.recv())
        except (EOFError, OSError):
            self._received.put(None)
