"""SLAM that was killed goes on: its map is kept in a file, and taken up by who starts next."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from threading import Event, Lock, Thread, get_native_id

from rclpy.node import Node

from hoid_common.errors import HoidError, MapFileError
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.slam_status import SlamMode, SlamState
from hoid_common.values import IntArray
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.map_io.checkpoint import Checkpoint, CheckpointFile
from rgbd_slam.map_transfer import LoadedMap
from rgbd_slam.ros.between_messages import BetweenMessages
from rgbd_slam.scene.dense_mapper import StoredView
from rgbd_slam.scene.dense_state import DenseState
from rgbd_slam.session import Processed, SlamSession
from rgbd_slam.statistics import SlamStats

_FIRST_S = 1.0  # a young map is written sooner, and each time half as often
_MAX_SHARE = 0.05  # of the time that writing may take
_NICE = 10  # of the thread that writes: tracking comes first
_LOOK_NS = 30 * 10**9  # for the camera; then a map is begun beside the one of the checkpoint
_NS = 1e9
_MS = 1e3
_LOOKING = 'resumed after a crash: looking for the camera in the map from before'
_FOUND = 'resumed after a crash: the camera is found in the map from before; mapping goes on'
_NOT_FOUND = 'not found in the map from before the crash: a new one is begun beside it'
_VALUE, _FAILED = 'checkpoint', 'checkpoints that failed'


class Checkpoints:
    """Writes the map at intervals, and resumes one that a killed node has left.

    Args:
        node: The SLAM node.
        config: Its parameters.
        diagnostics: Of the node.
        session: Gives the session, or None while there is none.
        views: Gives the images of the dense map, their colour at half the resolution of depth.
    """

    def __init__(
        self,
        node: Node,
        config: SlamNodeConfig,
        diagnostics: Diagnostics,
        session: Callable[[], SlamSession | None],
        views: Callable[[], list[StoredView]],
    ) -> None:
        self._logger = node.get_logger()
        self._diagnostics = diagnostics
        self._find_session, self._find_views = session, views
        self._between = BetweenMessages(node)
        self._period_s = config.checkpoint_period_s
        # Who localises in a given map has nothing to lose.
        self._is_on = self._period_s > 0 and config.mode == SlamMode.MAPPING.name.lower()
        domain = os.environ.get('ROS_DOMAIN_ID', '0')
        self._file = CheckpointFile(
            config.map_directory, f'{domain}{node.get_fully_qualified_name()}'
        )
        self._written: SlamStats | None = None
        self._lock = Lock()  # of the file
        self._found_by_ns: int | None = None  # while the camera is looked for
        self._stored = self._read() if self._is_on else None
        self._is_ended = Event()
        self._thread = Thread(target=self._run, name='checkpoints', daemon=True)
        if self._is_on:
            diagnostics.set_count(_FAILED, 0)
            diagnostics.set_value(_VALUE, 'none yet')
            self._thread.start()

    def resume(
        self, session: SlamSession, stamp_ns: int
    ) -> tuple[LoadedMap, DenseState | None] | None:
        """Load what a killed node has left, if the camera may be in it.

        Args:
            session: A new one; it does not map until the camera is found.
            stamp_ns: Of what the camera sent first.
        """
        stored = self._stored
        if stored is None or not stored.is_of(stamp_ns):
            return None
        try:
            loaded = session.load(stored.content)
        except MapFileError as error:
            self._logger.warning(f'the checkpoint is left: {error}')
            return None  # it may be of the next camera, where this one is corrected
        self._stored = None
        session.set_mode(SlamMode.LOCALIZATION)
        self._found_by_ns = stamp_ns + _LOOK_NS
        away_s = (stamp_ns - stored.stamp_ns) / _NS
        self._logger.warning(
            f'SLAM ended unasked {away_s:.1f} s ago: looking for the camera in its map of '
            f'{len(stored.content.map)} keyframes'
        )
        return loaded, stored.content.dense

    def followed(self, session: SlamSession, done: Processed) -> Processed:
        """Go on mapping once the camera is found; return what is to be said of the image."""
        if self._found_by_ns is None:
            return done
        is_found = done.status.state is SlamState.TRACKING
        if is_found or session.stamp_ns > self._found_by_ns:
            self._found_by_ns = None
            session.set_mode(SlamMode.MAPPING)
            self._logger.warning(_FOUND if is_found else _NOT_FOUND)
            return _saying(done, session.mode, _FOUND if is_found else _NOT_FOUND)
        return _saying(done, session.mode, _LOOKING)

    def forget(self) -> None:
        """Leave nothing to resume, as after a reset."""
        self._stored = self._found_by_ns = None
        with self._lock:
            self._written = None  # what is copied just now is not to be written any more
            if self._is_on:
                self._file.remove()

    def close(self, *, is_asked_for: bool) -> None:
        """End writing.

        Args:
            is_asked_for: Whether somebody ended the node, who then wants no more of its map.
        """
        self._is_ended.set()
        if is_asked_for:
            self.forget()

    def _read(self) -> Checkpoint | None:
        try:
            return self._file.read()
        except HoidError as error:
            self._logger.warning(f'the checkpoint is left: {error}')
            return None

    def _run(self) -> None:
        os.setpriority(os.PRIO_PROCESS, get_native_id(), _NICE)  # of this thread alone
        pause_s = usual_s = min(_FIRST_S, self._period_s)
        while not self._is_ended.wait(pause_s):
            took_s = 0.0
            try:
                took_s = self._write()
            except Exception as error:  # noqa: BLE001 - the next one may be written
                self._failed(error)
            usual_s = min(2 * usual_s, self._period_s)
            pause_s = max(usual_s, took_s / _MAX_SHARE)

    def _write(self) -> float:
        """Write the map if it has changed, and return how long that took, in s."""
        copied = self._between.call(self._copy)
        if copied is None:
            return 0.0
        checkpoint, uids, copy_ms = copied
        start_s = time.monotonic()
        if views := self._find_views():
            dense = DenseState.of_views(views, uids, is_halved=True)
            checkpoint = checkpoint._replace(content=checkpoint.content._replace(dense=dense))
        with self._lock:
            if self._written is None:
                return 0.0
            size = self._file.write(checkpoint)
        self._diagnostics.set_value(
            _VALUE,
            f'{len(checkpoint.content.map)} keyframes, {len(views)} images, '
            f'{size / 1e6:.1f} MB, copied in {copy_ms:.1f} ms, '
            f'written in {time.monotonic() - start_s:.2f} s',
        )
        self._diagnostics.clear_problem(_FAILED)
        return time.monotonic() - start_s

    def _copy(self) -> tuple[Checkpoint, IntArray, float] | None:
        """Copy the map between two images, if it has changed."""
        session = self._find_session()
        if session is None or session.map.is_empty or self._found_by_ns is not None:
            return None
        stats = session.stats
        if stats == self._written:
            self._file.touch(session.stamp_ns)
            return None
        start_s = time.perf_counter()
        content, uids = session.saved_map(), session.all_keyframes().uids
        self._written = stats
        copy_ms = _MS * (time.perf_counter() - start_s)
        return Checkpoint(content, session.stamp_ns), uids, copy_ms

    def _failed(self, error: Exception) -> None:
        self._written = None
        self._diagnostics.count(_FAILED)
        text = ' '.join(str(error).split())
        self._diagnostics.set_problem(_FAILED, f'the map is not kept for after a crash: {text}')


def _saying(done: Processed, mode: SlamMode, message: str) -> Processed:
    return done._replace(status=replace(done.status, mode=mode, message=message))
