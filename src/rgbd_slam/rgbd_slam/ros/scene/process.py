"""The process that maps the room, as the SLAM node sees it: posed images go in, nothing waits.

Images go to that process as they come from the camera, past the tracker: all it hears from the
tracker is where some of them were taken. What it publishes comes back, and so do the images that
its map is made of: when it dies, a new one makes the map of them again.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import RLock, Thread
from typing import Protocol

from hoid_common.errors import InputError
from hoid_common.process.child_process import ChildEndedError, ChildTimeoutError, ChildWorker
from hoid_common.values import CameraModel
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.ros.scene.messages import (
    Answer,
    ClearScene,
    KnownView,
    Order,
    Output,
    SceneMessage,
    SceneReport,
    SceneSetup,
)
from rgbd_slam.ros.scene.node import run_scene_node
from rgbd_slam.scene.dense_mapper import StoredView
from rgbd_slam.scene.fusion_scheduler import FusionRequest
from rgbd_slam.scene.view_ledger import ViewChange, ViewCopies

_MAX_WAITING = 30  # poses that the process has not taken yet
_ANSWER_S = 20.0  # for fusing all images anew, and a little more
_IDLE_S = 60.0
_SOON_S, _MAX_SOON = 20.0, 3  # that many ends in a row so soon after a start, and it is left be
_ENDED = 'the process of the dense map has ended; ask again'


class Listener(Protocol):
    """Who hears of the process, in a thread that only does that."""

    def published(self, output: Output) -> None:
        """Take a message to its topic."""
        ...

    def ended(self, how: str, *, is_restarted: bool) -> None:
        """Take notice of the process' end."""
        ...


@dataclass
class _Known:
    """What a new process must be told."""

    dense: DenseConfig
    camera: CameraModel | None = None
    keyframes: KeyframePoses | None = None


class SceneProcess:
    """Starts the process, hands poses over, and starts it anew when it ends.

    Args:
        setup: What the process is to know from the start.
        listener: Hears what it publishes, and of its end.
    """

    def __init__(self, setup: SceneSetup, listener: Listener) -> None:
        self.num_dropped = 0  # poses, because the process was behind or gone
        self._listener = listener
        self._known = _Known(setup.dense)
        self._copies = ViewCopies()
        self._numbers = count()
        self._answers: SimpleQueue[Answer] = SimpleQueue()
        self._lock = RLock()  # what is known, and the process that knows it
        self._is_closed = False
        self._num_soon, self._started_s = 0, time.monotonic()
        self._worker: ChildWorker[SceneMessage, SceneReport] = ChildWorker(
            'room', run_scene_node, setup
        )
        Thread(target=self._listen, name='from room', daemon=True).start()

    @property
    def num_restarts(self) -> int:
        """Return how often a process that had died was replaced."""
        return self._worker.num_restarts

    def start_map(self, camera: CameraModel) -> None:
        """Begin an empty map of what a camera sees."""
        with self._lock:
            self._known.camera, self._known.keyframes = camera, None
            self._copies.clear()
            self._worker.send(camera)

    def clear(self) -> None:
        """Forget the map until the next `start_map`."""
        with self._lock:
            self._known.camera = None
            self._copies.clear()
            self._worker.send(ClearScene())

    def reconfigure(self, dense: DenseConfig) -> None:
        """Hand over parameters that may change at run time."""
        with self._lock:
            self._known.dense = dense
            self._worker.send(dense)

    def enqueue(self, pose: FusionRequest) -> None:
        """Say where an image was taken."""
        self._known.keyframes = pose.keyframes or self._known.keyframes
        if self._worker.num_waiting >= _MAX_WAITING:
            self.num_dropped += 1
        else:
            self._worker.send(pose)

    def update_keyframes(self, keyframes: KeyframePoses) -> None:
        """Say where the keyframes are that images hang on."""
        with self._lock:
            self._known.keyframes = keyframes
            self._worker.send(keyframes)

    def restore(self, view: StoredView) -> None:
        """Add an image to the dense map that was saved before."""
        self._worker.send(view)

    def order(self, *, cloud_path: Path | None = None, grid_path: Path | None = None) -> int:
        """Ask for files to be written, or for an answer only, and return what to wait for."""
        number = next(self._numbers)
        self._worker.send(Order(number, cloud_path, grid_path))
        return number

    def await_answer(self, number: int) -> str:
        """Wait until an order is done and return what was; one order at a time.

        Raises:
            InputError: It could not be done, or the process has ended or takes too long.
        """
        end_s = time.monotonic() + _ANSWER_S
        while True:
            try:
                answer = self._answers.get(timeout=max(end_s - time.monotonic(), 0.0))
            except Empty:
                raise InputError(
                    f'the process of the dense map gives no answer in {_ANSWER_S:g} s'
                ) from None
            if answer.number >= number:  # the later one says that the process has ended
                break
        if not answer.success:
            raise InputError(answer.text)
        return answer.text

    def small_views(self) -> list[StoredView]:
        """Return the images that were kept last, their colour at half the resolution of depth."""
        return self._copies.small()

    def close(self) -> None:
        """End the process, by force when it does not end by itself."""
        with self._lock:
            self._is_closed = True
        self._worker.close()

    def _listen(self) -> None:
        while True:
            try:
                self._take(self._worker.receive(_IDLE_S))
            except ChildTimeoutError:
                continue
            except ChildEndedError:
                if not self._restart():
                    return

    def _take(self, report: SceneReport) -> None:
        match report:
            case Output():
                self._listener.published(report)
            case ViewChange():
                self._copies.apply(report)
            case Answer():
                self._answers.put(report)

    def _restart(self) -> bool:
        """Let a new process go on; return whether there is one."""
        self._answers.put(Answer(next(self._numbers), False, _ENDED))  # to all orders so far
        with self._lock:
            if self._is_closed:
                return False
            is_soon = time.monotonic() - self._started_s < _SOON_S
            self._num_soon = self._num_soon + 1 if is_soon else 0
            if self._num_soon >= _MAX_SOON:
                self._listener.ended(self._worker.close(), is_restarted=False)
                return False
            how = self._worker.restart()
            self._started_s = time.monotonic()
            self._tell_all()
        self._listener.ended(how, is_restarted=True)
        return True

    def _tell_all(self) -> None:
        """Tell a new process what the one before knew."""
        self._worker.send(self._known.dense)
        if self._known.camera is None:
            return
        self._worker.send(self._known.camera)
        if self._known.keyframes is not None:
            self._worker.send(self._known.keyframes)
            for slot, view in self._copies.views():
                self._worker.send(KnownView(slot, view))
