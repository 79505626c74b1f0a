"""The process that maps the room, as the SLAM node sees it: posed images go in, nothing waits.

Images go to that process as they come from the camera, past the tracker: all it hears from the
tracker is where some of them were taken. It ends when the pipe from the tracker does.
"""

from __future__ import annotations

import atexit
from multiprocessing import get_context
from queue import Empty, SimpleQueue
from threading import Thread

from hoid_common.child_process import start_child
from hoid_common.errors import InputError
from hoid_common.values import CameraModel
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.ros.scene_node import run_scene_node
from rgbd_slam.ros.scene_setup import ClearScene, SceneMessage, SceneSetup, StoredViewsRequest
from rgbd_slam.scene.dense_mapper import StoredView
from rgbd_slam.scene.fusion_scheduler import FusionRequest

_MAX_WAITING = 30  # poses that the process has not taken yet
_REPORT_S = 20.0  # for fusing all images anew, and a little more
_END_S = 5.0


class SceneProcess:
    """Starts the process and hands poses over.

    Args:
        setup: What the process is to know from the start.
    """

    def __init__(self, setup: SceneSetup) -> None:
        self.num_dropped = 0  # poses, because the process was behind
        self._waiting: SimpleQueue[SceneMessage | None] = SimpleQueue()
        context = get_context('spawn')
        reader, self._writer = context.Pipe(duplex=False)
        self._reader, writer = context.Pipe(duplex=False)
        self._process = context.Process(
            target=run_scene_node, args=(reader, writer, setup), name='room'
        )
        start_child(self._process)
        reader.close()
        writer.close()
        self._views: SimpleQueue[StoredView | None] = SimpleQueue()
        atexit.register(self.close)  # before multiprocessing waits for the process
        self._sender = Thread(target=self._send, name='to room', daemon=True)
        self._sender.start()
        Thread(target=self._receive, name='from room', daemon=True).start()

    @property
    def process_id(self) -> int | None:
        """Return the id of the process."""
        return self._process.pid

    @property
    def is_running(self) -> bool:
        """Return whether the process is there."""
        return self._process.is_alive()

    def start_map(self, camera: CameraModel) -> None:
        """Begin an empty map of what a camera sees."""
        self._waiting.put(camera)

    def clear(self) -> None:
        """Forget the map until the next `start_map`."""
        self._waiting.put(ClearScene())

    def reconfigure(self, dense: DenseConfig) -> None:
        """Hand over parameters that may change at run time."""
        self._waiting.put(dense)

    def enqueue(self, pose: FusionRequest) -> None:
        """Say where an image was taken."""
        if self._waiting.qsize() >= _MAX_WAITING:
            self.num_dropped += 1
        else:
            self._waiting.put(pose)

    def update_keyframes(self, keyframes: KeyframePoses) -> None:
        """Say where the keyframes are that images hang on."""
        self._waiting.put(keyframes)

    def restore(self, view: StoredView) -> None:
        """Add an image to the dense map that was saved before."""
        self._waiting.put(view)

    def ask_views(self) -> None:
        """Ask for the images of the dense map as it is now."""
        self._waiting.put(StoredViewsRequest())

    def receive_views(self) -> list[StoredView]:
        """Wait for them.

        Raises:
            InputError: The process has ended, or takes too long.
        """
        views: list[StoredView] = []
        try:
            while (view := self._views.get(timeout=_REPORT_S)) is not None:
                views.append(view)
        except Empty:
            raise InputError(
                f'the process of the dense map gives no answer in {_REPORT_S:g} s'
            ) from None
        return views

    def close(self) -> None:
        """End the process, by force when it does not end by itself."""
        atexit.unregister(self.close)
        self._waiting.put(None)
        self._sender.join(_END_S)
        self._writer.close()
        self._process.join(_END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _send(self) -> None:
        try:
            while (message := self._waiting.get()) is not None:
                self._writer.send(message)
        except OSError:
            pass  # the process has ended; `is_running` says so

    def _receive(self) -> None:
        try:
            while True:
                self._views.put(self._reader.recv())
        except (EOFError, OSError):
            self._views.put(None)  # the process has ended, with all its images
