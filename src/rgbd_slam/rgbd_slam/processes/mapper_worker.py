"""The process that maps, and the two ends of the pipes to it.

It takes keyframes and sends back the rows of the map that changed. Two threads of the tracker's
process move the bytes; what they share with it are queues. The process ends when the pipe from the
tracker does, so that it outlives neither `close` nor a killed tracker.
"""

from __future__ import annotations

import atexit
import os
from multiprocessing import get_context
from multiprocessing.connection import Connection
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import NamedTuple

from hoid_common.child_process import start_child
from hoid_common.errors import HoidError
from hoid_common.values import FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closing import LoopCounts
from rgbd_slam.mapper import KeyframeRequest, Mapper
from rgbd_slam.model.atlas import Atlas, MapChange
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.map_state import MapState

_NICE = 5  # below tracking, which does not wait for it
_IDLE_S = 0.2  # between looks for results of the background
_END_S = 5.0


class MapperStoppedError(HoidError):
    """The mapping process is gone, or does not answer."""


class Start(NamedTuple):
    """Asks for the first keyframe of a map."""

    frame: Frame
    T_map_camera: FloatArray  # (4, 4)
    map_id: int


class Resume(NamedTuple):
    """Asks to go on with the map that a process before this one has left."""

    whole: MapChange
    loops: LoopCounts


class Settle(NamedTuple):
    """Asks to wait for what runs in the background."""

    limit_s: float


class Load(NamedTuple):
    """Asks to lay a saved map over the running one."""

    state: MapState
    keep: bool  # the running one, beside it


Request = Start | Load | Resume | Settle | KeyframeRequest


class Report(NamedTuple):
    """What the mapper sends after each request, and after changes of its own."""

    change: MapChange
    row: int | None  # of the keyframe that a request made first
    loops: LoopCounts
    is_answer: bool
    is_settled: bool  # whether nothing runs in the background


def run_mapper(
    requests: Connection, reports: Connection, camera: StereoCamera, config: SlamConfig
) -> None:
    """Take keyframes in until the pipe ends; the main function of the process."""
    os.nice(_NICE)
    atlas = Atlas(config.camera.scale_factor, config.camera.num_octaves)
    mapper = Mapper(camera, atlas, config, background=True)
    version = 0
    reports.send(None)  # ready
    try:
        while True:
            is_answer, row = requests.poll(_IDLE_S), None
            if is_answer:
                row = _do(mapper, requests.recv())
            elif not mapper.poll():
                continue
            change = atlas.changes_since(version)
            version = change.version
            settled = not mapper.is_adjusting
            reports.send(Report(change, row, mapper.loops, is_answer, settled))
    except (EOFError, BrokenPipeError):
        pass  # the tracker has ended
    finally:
        mapper.close()


def _do(mapper: Mapper, request: Request) -> int | None:
    match request:
        case KeyframeRequest():
            return mapper.insert(request)
        case Settle(limit_s):
            mapper.settle(limit_s)
        case Resume(whole, loops):
            mapper.map.apply(whole)
            mapper.loops = loops
        case Load(state, keep):
            return mapper.load(state, keep=keep)
        case Start(frame, T_map_camera, map_id):
            return mapper.start_map(frame, T_map_camera, map_id)
    return None


class MapperWorker:
    """The tracker's end of one such process."""

    def __init__(self, camera: StereoCamera, config: SlamConfig) -> None:
        self._to_send: SimpleQueue[Request | None] = SimpleQueue()
        self._received: SimpleQueue[Report | None] = SimpleQueue()
        self._started = Event()
        context = get_context('spawn')
        request_reader, self._requests = context.Pipe(duplex=False)
        self._reports, report_writer = context.Pipe(duplex=False)
        self._process = context.Process(
            target=run_mapper, args=(request_reader, report_writer, camera, config), name='mapper'
        )
        start_child(self._process)
        request_reader.close()
        report_writer.close()
        atexit.register(self.close)  # before multiprocessing waits for the process
        self._sender = Thread(target=self._send, name='to mapper', daemon=True)
        self._receiver = Thread(target=self._receive, name='from mapper', daemon=True)
        self._sender.start()
        self._receiver.start()

    @property
    def process_id(self) -> int | None:
        """Return the id of the process."""
        return self._process.pid

    def await_start(self, limit_s: float) -> None:
        """Wait until the process takes requests, or has ended.

        Raises:
            MapperStoppedError: It needs longer.
        """
        if not self._started.wait(limit_s):
            raise MapperStoppedError(
                f'the mapping process did not start in {limit_s:g} s: the machine is too busy; '
                'free it and start the node again'
            )

    def send(self, request: Request) -> None:
        """Hand a request over, without waiting."""
        self._to_send.put(request)

    @property
    def has_report(self) -> bool:
        """Return whether `receive` would not wait."""
        return not self._received.empty()

    def receive(self, timeout_s: float) -> Report | None:
        """Return the next report; None, from then on, when the process has ended.

        Raises:
            MapperStoppedError: There is none in time.
        """
        try:
            report = self._received.get(timeout=timeout_s)
        except Empty:
            raise MapperStoppedError(
                f'the mapping process gives no answer in {timeout_s:g} s: the machine is too busy '
                'for it; free it and restart the node'
            ) from None
        if report is None:
            self._received.put(None)
        return report

    def close(self) -> int | None:
        """End the process and return its exit code; keyframes still under way are lost."""
        atexit.unregister(self.close)
        self._to_send.put(None)
        self._sender.join(_END_S)
        self._requests.close()
        self._process.join(_END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._receiver.join(_END_S)
        self._reports.close()
        return self._process.exitcode

    def _send(self) -> None:
        try:
            while (request := self._to_send.get()) is not None:
                self._requests.send(request)
        except OSError:
            pass  # the receiver says so

    def _receive(self) -> None:
        try:
            while True:
                report = self._reports.recv()
                self._started.set()
                if report is not None:
                    self._received.put(report)
        except (EOFError, OSError):
            self._received.put(None)
            self._started.set()
