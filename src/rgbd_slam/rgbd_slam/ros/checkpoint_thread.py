"""A thread that writes the node's map to its database at intervals, while images are tracked."""

from __future__ import annotations

import operator
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from threading import Event, Lock, RLock, Thread, get_native_id
from typing import NamedTuple

from rclpy.node import Node

from hoid_common.errors import HoidError, counted
from hoid_common.ros.diagnostics import Diagnostics
from rgbd_slam.ros.node_thread import NodeThread
from rgbd_slam.session import SlamSession
from rgbd_slam.store.map_parts import MapPart
from rgbd_slam.store.map_writer import MapWriter
from rgbd_slam.store.running_map import RunningMap
from rgbd_slam.store.tables import MapHeader

# Chosen: time until the first checkpoint; later intervals double up to `checkpoint_period_s`.
_FIRST_S = 1.0
_MAX_SHARE = 0.05  # chosen: largest ratio of the time that is spent on writing
# Chosen: largest ratio of the tracker's time that is spent on copying a large map in parts.
_MAX_COPY_SHARE = 0.2
_NICE = 10  # priority below tracking and mapping (decision 016)
_MS = 1e3
_VALUE, _FAILED = 'checkpoint', 'checkpoints that failed'


class _Copied(NamedTuple):
    """A copied part of the map, and the header of the checkpoint."""

    part: MapPart
    header: MapHeader
    version: int  # version of the map when it was copied
    copy_s: float  # duration of the copy, for which the tracker waited


class CheckpointThread:
    """Writes the changes of the map about every `period_s`, in a thread of low priority."""

    def __init__(
        self,
        node: Node,
        period_s: float,
        running: RunningMap,
        diagnostics: Diagnostics,
        session: Callable[[], SlamSession | None],
    ) -> None:
        self._logger = node.get_logger()
        self._diagnostics = diagnostics
        self._find_session = session
        self._node_thread = NodeThread(node)
        self._period_s, self._running = period_s, running
        # True: nothing is written, because the camera is still being localized in the stored map.
        self.is_paused = False
        # True: the session continues the stored map; False: the stored map is kept under another
        # name.
        self.continues_stored = False
        self._writer: MapWriter | None = None
        # Version of the map in the last committed checkpoint; None: no checkpoint is committed.
        self._written: int | None = None
        self._lock = RLock()  # guards the database and its writer
        self._is_writing = Lock()  # held by the thread that writes, other than the node's
        self._is_ended = Event()
        diagnostics.set_count(_FAILED, 0)
        diagnostics.set_value(_VALUE, 'none yet')
        Thread(target=self._run, name='checkpoints', daemon=True).start()

    def end(self) -> None:
        self._is_ended.set()

    def keep(self) -> None:
        """Rename the stored map, so that it is a saved map that no node resumes.

        Unless `is_paused`, the latest changes are written to it first.
        """
        with self._lock:  # what another thread is writing now must not reach the database later
            try:
                if self._writer is not None:
                    self._writer.abort()
                if not self.is_paused:
                    self._write(is_last=True)
            except Exception as error:  # noqa: BLE001 - the previous checkpoint is kept
                self._report_failure(error)
            self._use_writer(None)
            self.is_paused = self.continues_stored = False
            self._keep_stored()

    def copy_to(self, path: Path) -> bool:
        """Write the changes, then copy the stored map to `path`; return False if there is no map.

        Call this in another thread than the node's.

        Raises:
            HoidError: The map cannot be written.
        """
        with self._is_writing:
            self._write()
            with self._lock:
                if self._written is None:
                    return False
                self._running.copy_to(path)
                return True

    def _keep_stored(self) -> bool:
        """Rename the stored map; if that is not possible, log the reason and return False."""
        try:
            kept = self._running.keep()
        except (HoidError, OSError) as error:
            self._report_failure(error)
            return False
        if kept:
            self._logger.info(kept)
        return True

    def _use_writer(self, writer: MapWriter | None) -> None:
        if self._writer is not None:
            self._writer.abort()
        self._writer, self._written = writer, None

    def _run(self) -> None:
        os.setpriority(os.PRIO_PROCESS, get_native_id(), _NICE)  # niceness of this thread only
        pause_s = usual_s = min(_FIRST_S, self._period_s)
        while not self._is_ended.wait(pause_s):
            took_s = 0.0
            try:
                with self._is_writing:
                    took_s = self._write()
            except Exception as error:  # noqa: BLE001 - the next checkpoint may succeed
                self._report_failure(error)
            usual_s = min(2 * usual_s, self._period_s)
            pause_s = max(usual_s, took_s / _MAX_SHARE)

    def _write(self, *, is_last: bool = False) -> float:
        """Write the changes of the map; return the duration (s) of writing.

        With `is_last`, the node's thread calls this, and does not wait between parts of the map.
        """
        call = operator.call if is_last else self._node_thread.call
        task = call(self._begin)
        start_s, longest_s, wrote_s = time.monotonic(), 0.0, 0.0
        if task is None or not self._open(*task):
            return 0.0
        writer, _ = task
        try:
            while (copied := call(partial(self._copy, writer))) is not None:
                longest_s = max(longest_s, copied.copy_s)
                part_s = time.monotonic()
                if not self._append(writer, copied):
                    break
                wrote_s += time.monotonic() - part_s
                if (keyframes := copied.part.keyframes) is not None:
                    self._report(len(keyframes.uid), time.monotonic() - start_s, longest_s)
                    break
                if not is_last:
                    self._is_ended.wait(copied.copy_s / _MAX_COPY_SHARE)
        finally:
            with self._lock:
                writer.abort()  # no effect after the last part
        return wrote_s

    def _begin(self) -> tuple[MapWriter, MapHeader | None] | None:
        """Return the writer of the next checkpoint; None if none is due. Called between images.

        If the map has not changed since the last checkpoint, also return its header, because only
        the header is written then.
        """
        session = self._find_session()
        if session is None or self.is_paused:
            return None
        atlas = session.map.atlas
        if len(atlas.keyframes) == 0:
            return None
        if self._writer is None or self._writer.atlas is not atlas:
            return self._running.writer(atlas), None
        is_same = atlas.version == self._written and self._running.path.exists()
        header = session.map.header(session.stamp_ns)
        return self._writer, header if is_same else None

    def _open(self, writer: MapWriter, header: MapHeader | None) -> bool:
        """Begin the transaction of a checkpoint; return False if no part needs to be copied."""
        with self._lock:
            if writer is not self._writer:
                if not self.continues_stored and not self._keep_stored():
                    return False
                self._use_writer(writer)
                self.continues_stored = False
            if header is not None:
                writer.touch(header)
                return False
            writer.begin()
            return True

    def _copy(self, writer: MapWriter) -> _Copied | None:
        """Copy the next part of the map; None if the map was discarded. Called between images."""
        session = self._find_session()
        if session is None or writer is not self._writer or not writer.is_open:
            return None
        if session.map.atlas is not writer.atlas:
            return None
        start_s = time.perf_counter()
        part, version = writer.copy(), writer.atlas.version
        header = session.map.header(session.stamp_ns)
        return _Copied(part, header, version, time.perf_counter() - start_s)

    def _append(self, writer: MapWriter, copied: _Copied) -> bool:
        """Write a part of the map; if the map was discarded, return False without writing."""
        with self._lock:
            if writer is not self._writer or not writer.is_open:
                return False
            if writer.append(copied.part, copied.header):
                # Only now, because the transaction fails on a full disk.
                self._written = copied.version
            return True

    def _report(self, num_keyframes: int, took_s: float, longest_s: float) -> None:
        text = (
            f'{counted(num_keyframes, "keyframe")} written in {took_s:.2f} s, copied in at most '
            f'{_MS * longest_s:.1f} ms each'
        )
        self._diagnostics.set_value(_VALUE, text)
        self._diagnostics.clear_problem(_FAILED)

    def _report_failure(self, error: Exception) -> None:
        self._written = None
        self._diagnostics.count(_FAILED)
        text = (
            f'the map cannot be stored to resume it after a crash: {" ".join(str(error).split())}'
        )
        self._diagnostics.set_problem(_FAILED, text)
