"""The SLAM node's handle of the scene process, a child process that is replaced when it dies.

The scene process receives camera images by topics, and only their poses from the SLAM node, so
that the tracker copies no image and does not wait for the maps. It sends back the messages to
publish, and the changes of the list of images that its dense map is made of. The files of these
images are in a folder that both processes use. After a process has died, a new one makes the dense
map again from these images and from loaded maps. After three deaths in a row within 20 s of the
start, no new one is started.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import RLock, Thread
from typing import TypeVar

from hoid_common.errors import InputError
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.process.child_process import ChildEndedError, ChildTimeoutError, ChildWorker
from hoid_common.values import CameraModel, IntArray
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.dense.stored_view import StoredView, ViewChange, ViewList
from hoid_scene.dense.submap_export import ExportMark, SubmapExport
from hoid_scene.dense.submap_state import SubmapState
from hoid_scene.dense.view_folder import ViewFolder
from hoid_scene.objects.object_map_state import ObjectMapState
from hoid_scene.scene_scheduler import SceneRequest
from rgbd_slam.ros.scene.messages import (
    ClearScene,
    CommandResult,
    Output,
    SavedObjects,
    SavedSubmaps,
    SceneCommand,
    SceneExport,
    SceneMessage,
    SceneReport,
    SceneSetup,
    Subscribed,
)
from rgbd_slam.ros.scene.node import run_scene_node

T = TypeVar('T')

# Chosen: number of queued messages from which requests are dropped; 2 s at the default rates.
_MAX_WAITING = 30
# Time limit for a command. Chosen: more than rebuilding the dense map takes, for which it waits.
_RESULT_S = 20.0
_IDLE_S = 60.0  # time limit for one wait for a report; it has no effect, as waits are repeated
# Chosen: the third process in a row that ends within this time [s] after its start is not
# replaced.
_SOON_S, _MAX_SOON = 20.0, 3
_ENDED = 'the process of the dense map has ended; ask again'


@dataclass
class _State:
    """The messages that a new process needs to continue, beside the stored images."""

    dense: DenseConfig
    subscribed: Subscribed = field(default_factory=Subscribed)
    camera: CameraModel | None = None
    keyframes: KeyframePoses | None = None
    loaded: list[SavedSubmaps] = field(default_factory=list)
    # The object maps that were loaded; instead of these, the one that was saved last, if any.
    objects: list[SavedObjects] = field(default_factory=list)


class SceneProcess:
    """Starts the scene process, sends messages to it, and replaces it when it dies.

    After three early deaths in a row it is not replaced; messages are then lost.

    Args:
        setup: Parameters of the scene process.
        on_output: Called with each message to publish, in a thread of this object.
        on_end: Called when the process has died before `close`, in the same thread. Arguments: how
            it ended, and whether a new process was started.
    """

    def __init__(
        self,
        setup: SceneSetup,
        on_output: Callable[[Output], None],
        on_end: Callable[[str, bool], None],
    ) -> None:
        self.num_dropped = 0  # requests that were not sent, because the process was late or dead
        self._on_output, self._on_end = on_output, on_end
        self._state = _State(setup.dense)
        self._views = ViewList()
        self._folder = ViewFolder()
        self._numbers = count()
        self._results: dict[int, SimpleQueue[CommandResult]] = {}  # of the commands in progress
        self._lock = RLock()  # guards `_state` and the start of a process that receives it
        self._num_cleared = 0  # how often the scene was discarded
        self._unread: list[Path] = []  # files of results that came too late
        self._is_closed = False
        self._num_soon, self._started_s = 0, time.monotonic()
        self._worker: ChildWorker[SceneMessage, SceneReport] = ChildWorker(
            'scene', run_scene_node, setup._replace(folder=self._folder.path)
        )
        Thread(target=self._listen, name='from scene', daemon=True).start()

    def send(
        self,
        message: (
            CameraModel
            | ClearScene
            | DenseConfig
            | KeyframePoses
            | SavedObjects
            | SavedSubmaps
            | StoredView
            | Subscribed
        ),
    ) -> None:
        """Send a message that changes the scene.

        If the process dies, the process that replaces it is sent the parameters, keyframes, saved
        maps and reported images again; `_restore_state` says what is lost. A process that keeps
        ending soon after its start is not replaced.
        """
        with self._lock:
            match message:
                case CameraModel():
                    self._state.camera, self._state.keyframes = message, None
                    self._forget()
                case ClearScene():
                    self._state.camera = None
                    self._forget()
                case DenseConfig():
                    self._state.dense = message
                case Subscribed():
                    self._state.subscribed = message
                case KeyframePoses():
                    self._state.keyframes = message
                case SavedSubmaps():
                    self._state.loaded.append(message)
                case SavedObjects():
                    self._state.objects.append(message)
            self._worker.send(message)

    def enqueue(self, request: SceneRequest) -> None:
        """Send a request, unless too many are waiting; dropped requests are counted."""
        self._state.keyframes = request.keyframes or self._state.keyframes
        if self._worker.num_waiting >= _MAX_WAITING:
            self.num_dropped += 1
        else:
            self._worker.send(request)

    def command(self, command: SceneCommand) -> int:
        """Send a command, and return its number for `await_result`; its own number is ignored."""
        return self._send_command(command._replace(number=next(self._numbers)))

    def request_maps(
        self, keyframes: KeyframePoses, since: ExportMark | None
    ) -> Callable[[], SceneExport]:
        """Request dense map and object map, relative to keyframes that are saved with them.

        The process corrects the scene by these keyframes first. A process that replaces it is
        given the object map that was received last, unless the scene was discarded after the
        request.

        Args:
            keyframes: These keyframes.
            since: Only the submaps that have changed since this export; None: all.

        Returns:
            A function that waits for the maps and returns them. It raises InputError as
            `await_result` does.
        """
        self._remove_unread()
        paths = [self._folder.path / f'saved-{next(self._numbers)}.npz' for _ in range(2)]
        submaps_path, objects_path = paths
        with self._lock:
            self.send(keyframes)
            number = self.command(
                SceneCommand(
                    submaps_path=submaps_path, submaps_since=since, objects_path=objects_path
                )
            )
            num_cleared = self._num_cleared

        def receive() -> SceneExport:
            try:
                self.await_result(number)
            except InputError:
                self._unread.extend(paths)  # a late process may write them yet
                raise
            submaps = _taken(submaps_path, SubmapExport.read)
            objects = _taken(objects_path, ObjectMapState.read)
            with self._lock:
                if objects is not None and num_cleared == self._num_cleared:
                    self._state.objects = [SavedObjects(objects, keyframes.uids)]
            return SceneExport(submaps, objects)

        return receive

    def stored(self, submaps: SubmapState, keyframe_uids: IntArray) -> SavedSubmaps:
        """Write the dense map of a saved map to a file, and return the message that adds it.

        Args:
            submaps: The dense map.
            keyframe_uids: (K,) present uids of the keyframes, in the order of the saved map.

        Raises:
            OSError: The file cannot be written.
        """
        path = self._folder.path / f'loaded-{next(self._numbers)}.npz'
        submaps.write(path)
        return SavedSubmaps(path, keyframe_uids)

    def _send_command(self, command: SceneCommand) -> int:
        with self._lock:
            self._results[command.number] = SimpleQueue()
            self._worker.send(command)
        return command.number

    def _remove_unread(self) -> None:
        for path in [path for path in self._unread if path.exists()]:
            path.unlink()
            self._unread.remove(path)

    def _forget(self) -> None:
        self._views.clear()
        self._state.loaded.clear()
        self._state.objects.clear()
        self._num_cleared += 1

    def await_result(self, number: int) -> CommandResult:
        """Wait until a command is completed, and return its result; call it once per command.

        Raises:
            InputError: The command failed, the process has ended, or it takes more than 20 s.
        """
        try:
            result = self._results[number].get(timeout=_RESULT_S)
        except Empty:
            raise InputError(
                f'the process of the dense map gives no answer in {_RESULT_S:g} s'
            ) from None
        finally:
            del self._results[number]
        if not result.success:
            raise InputError(result.text)
        return result

    def close(self) -> None:
        """End the process, killing it if it does not end by itself, and delete its files."""
        with self._lock:
            self._is_closed = True
        self._worker.close()
        self._folder.close()

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
                self._on_output(report)
            case ViewChange():
                self._views.apply(report)
            case CommandResult():
                if (waiting := self._results.get(report.number)) is not None:
                    waiting.put(report)

    def _restart(self) -> bool:
        """Replace the process that has died; return whether a new one was started.

        No process is started after `close`, or if three in a row have ended within 20 s after
        their start. Commands in progress fail.
        """
        with self._lock:
            for number, waiting in list(self._results.items()):
                waiting.put(CommandResult(number, False, _ENDED))
            if self._is_closed:
                return False
            is_soon = time.monotonic() - self._started_s < _SOON_S
            self._num_soon = self._num_soon + 1 if is_soon else 0
            if self._num_soon >= _MAX_SOON:
                self._on_end(self._worker.close(), False)
                return False
            how = self._worker.restart()
            self._started_s = time.monotonic()
            self._restore_state()
        self._on_end(how, True)
        return True

    def _restore_state(self) -> None:
        """Send a new process the parameters, keyframes, images and saved maps of its predecessor.

        Tracks, counted crossings and waiting requests are lost, and so are changes of the object
        map since it was last loaded or requested, and images that the predecessor had not
        reported.
        """
        self._worker.send(self._state.dense)
        self._worker.send(self._state.subscribed)
        if self._state.camera is None:
            return
        self._worker.send(self._state.camera)
        if self._state.keyframes is not None:
            self._worker.send(self._state.keyframes)
            for loaded in self._state.loaded:
                self._worker.send(loaded)
            for view in self._views.views():
                self._worker.send(view)
            for objects in self._state.objects:
                self._worker.send(objects)


def _taken(path: Path, read: Callable[[Path], T]) -> T | None:
    """Return the content of a temporary file, and delete it; None if there is no such file."""
    if not path.exists():
        return None
    content = read(path)
    path.unlink()
    return content
