"""Checkpoints of the map, with which a node that was killed resumes (decision 030)."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from threading import Event, Lock, Thread, get_native_id

from rclpy.node import Node

from hoid_common.errors import HoidError, InputError, MapFileError
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.slam_status import SlamMode, SlamState
from hoid_common.values import NS_PER_S
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.dense.submap_state import DenseMap, SubmapState
from rgbd_slam.map_io.checkpoint import Checkpoint, CheckpointFile
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.robot_map import LoadedMap
from rgbd_slam.ros.node_thread import NodeThread
from rgbd_slam.session import Processed, SlamSession
from rgbd_slam.statistics import SlamStats

_FIRST_S = 1.0  # chosen: a young map is written after 1 s, and then at doubling intervals
_MAX_SHARE = 0.05  # chosen: the share of the time that may be spent on writing
_NICE = 10  # lower priority than tracking and mapping (decision 016)
# Chosen: how long the camera is relocalized in the old map before a new map is started beside it.
_RELOCALIZE_NS = 30 * NS_PER_S
_MS = 1e3
_SEARCHING = 'resumed after a crash: relocalizing the camera in the map from before'
_FOUND = 'resumed after a crash: the camera is found in the map from before; mapping goes on'
_NOT_FOUND = 'not found in the map from before the crash: a new map is started beside it'
_VALUE, _FAILED = 'checkpoint', 'checkpoints that failed'


class Checkpoints:
    """Writes the map at intervals, and resumes the map that a killed node has left.

    Args:
        node: The SLAM node.
        config: Its parameters.
        diagnostics: Diagnostics of the node.
        session: Returns the session, or None while there is no session.
        request_submaps: Requests the dense map; returns a function that waits for it.
    """

    def __init__(
        self,
        node: Node,
        config: SlamNodeConfig,
        diagnostics: Diagnostics,
        session: Callable[[], SlamSession | None],
        request_submaps: Callable[[KeyframePoses], Callable[[], SubmapState | None] | None],
    ) -> None:
        self._logger = node.get_logger()
        self._diagnostics = diagnostics
        self._find_session, self._request_submaps = session, request_submaps
        self._node_thread = NodeThread(node)
        self._period_s = config.checkpoint_period_s
        # A node that localizes in a given map does not change it, so that a crash loses nothing.
        self._is_on = self._period_s > 0 and config.mode == SlamMode.MAPPING.name.lower()
        domain = os.environ.get('ROS_DOMAIN_ID', '0')
        self._file = CheckpointFile(
            config.map_directory, f'{domain}{node.get_fully_qualified_name()}'
        )
        self._written: SlamStats | None = None  # statistics of the map in the file
        # Whether the file was written once more after the map had stopped changing: the dense map
        # is behind the map by some images.
        self._is_dense_written = False
        self._lock = Lock()  # of the file
        self._search_end_ns: int | None = None  # while the camera is relocalized in the old map
        self._stored = self._read() if self._is_on else None
        self._is_ended = Event()
        self._thread = Thread(target=self._run, name='checkpoints', daemon=True)
        if self._is_on:
            diagnostics.set_count(_FAILED, 0)
            diagnostics.set_value(_VALUE, 'none yet')
            self._thread.start()

    def resume(
        self, session: SlamSession, stamp_ns: int
    ) -> tuple[LoadedMap, DenseMap | None] | None:
        """Load the map that a killed node has left into a new session, and return it.

        The session only localizes until `finish_resume` returns it to mapping. None is returned if
        there is no checkpoint, or if it is too old or from another camera.

        Args:
            session: The new session.
            stamp_ns: Stamp of the camera's first message.
        """
        stored = self._stored
        if stored is None or not stored.is_recent(stamp_ns):
            return None
        try:
            loaded = session.robot_map.load(stored.content)
        except MapFileError as error:
            self._logger.warning(f'the checkpoint is not used: {error}')
            return None  # it is kept, because a corrected camera info that fits it may follow
        self._stored = None
        session.set_mode(SlamMode.LOCALIZATION)
        self._search_end_ns = stamp_ns + _RELOCALIZE_NS
        away_s = (stamp_ns - stored.stamp_ns) / NS_PER_S
        self._logger.warning(
            f'SLAM ended unexpectedly {away_s:.1f} s ago: relocalizing the camera in its map of '
            f'{len(stored.content.map)} keyframes'
        )
        return loaded, stored.content.dense

    def finish_resume(self, session: SlamSession, done: Processed) -> Processed:
        """Switch the session to mapping once the camera is found or the search has taken too long.

        Args:
            session: The session.
            done: The results of the latest image.

        Returns:
            The same results; during a resume, their status has its mode and message.
        """
        if self._search_end_ns is None:
            return done
        is_found = done.status.state is SlamState.TRACKING
        message = _SEARCHING
        if is_found or session.stamp_ns > self._search_end_ns:
            self._search_end_ns = None
            session.set_mode(SlamMode.MAPPING)
            message = _FOUND if is_found else _NOT_FOUND
            self._logger.warning(message)
        return done._replace(status=replace(done.status, mode=session.mode, message=message))

    def discard(self) -> None:
        """Delete the checkpoint, so that nothing is resumed, as after a reset."""
        self._stored = self._search_end_ns = None
        with self._lock:
            self._written = None  # a copy that is being written now must not reach the file
            if self._is_on:
                self._file.remove()

    def close(self, *, is_asked_for: bool) -> None:
        """End the thread, and delete the checkpoint if the end was requested.

        Args:
            is_asked_for: True if an operator or launch ended the node; False after an error, so
                that the next node resumes the map.
        """
        self._is_ended.set()
        if is_asked_for:
            self.discard()

    def _read(self) -> Checkpoint | None:
        try:
            return self._file.read()
        except HoidError as error:
            self._logger.warning(f'the checkpoint is not used: {error}')
            return None

    def _run(self) -> None:
        os.setpriority(os.PRIO_PROCESS, get_native_id(), _NICE)  # of this thread alone
        pause_s = usual_s = min(_FIRST_S, self._period_s)
        while not self._is_ended.wait(pause_s):
            took_s = 0.0
            try:
                took_s = self._write()
            except Exception as error:  # noqa: BLE001 - the next one may be written
                self._report_failure(error)
            usual_s = min(2 * usual_s, self._period_s)
            pause_s = max(usual_s, took_s / _MAX_SHARE)

    def _write(self) -> float:
        """Write the map if it has changed, and return the time [s] that writing took."""
        copied = self._node_thread.call(self._copy)
        if copied is None:
            return 0.0
        checkpoint, receive_submaps, copy_ms = copied
        start_s = time.monotonic()
        dense = None
        if receive_submaps is not None:
            with suppress(InputError):  # its process has just ended, or is late
                dense = receive_submaps()
        checkpoint = checkpoint._replace(content=checkpoint.content._replace(dense=dense))
        with self._lock:
            if self._written is None:
                return 0.0
            size = self._file.write(checkpoint)
        self._diagnostics.set_value(
            _VALUE,
            f'{len(checkpoint.content.map)} keyframes, '
            f'{0 if dense is None else len(dense)} voxels, {size / 1e6:.1f} MB, '
            f'copied in {copy_ms:.1f} ms, '
            f'written in {time.monotonic() - start_s:.2f} s',
        )
        self._diagnostics.clear_problem(_FAILED)
        return time.monotonic() - start_s

    def _copy(
        self,
    ) -> tuple[Checkpoint, Callable[[], SubmapState | None] | None, float] | None:
        """Return a copy of the map, a function that waits for its dense map, and the time [ms].

        This runs between two images. None is returned if the map is unchanged, and while the
        camera is being relocalized in the old map, whose file must be kept.
        """
        session = self._find_session()
        if session is None or session.slam.map.is_empty or self._search_end_ns is not None:
            return None
        stats = session.slam.stats
        if stats == self._written and self._is_dense_written:
            self._file.touch(session.stamp_ns)
            return None
        self._is_dense_written = stats == self._written
        start_s = time.perf_counter()
        content = session.robot_map.export()
        receive_submaps = self._request_submaps(session.robot_map.keyframes())
        self._written = stats
        copy_ms = _MS * (time.perf_counter() - start_s)
        return Checkpoint(content, session.stamp_ns), receive_submaps, copy_ms

    def _report_failure(self, error: Exception) -> None:
        self._written = None
        self._diagnostics.count(_FAILED)
        text = ' '.join(str(error).split())
        self._diagnostics.set_problem(
            _FAILED, f'the map cannot be stored to resume it after a crash: {text}'
        )
