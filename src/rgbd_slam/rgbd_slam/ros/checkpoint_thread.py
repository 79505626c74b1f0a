"""Writes the map of the node to its database at intervals, while images are tracked."""

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

# Chosen: the first checkpoint is written after this time, the others at doubling intervals up to
# `checkpoint_period_s`.
_FIRST_S = 1.0
_MAX_SHARE = 0.05  # chosen: largest share of the time that is spent on writing
# Chosen: largest share of the tracker's time that is spent on copying a large map in parts.
_MAX_COPY_SHARE = 0.2
_NICE = 10  # lower priority than tracking and mapping (decision 016)
_MS = 1e3
_VALUE, _FAILED = 'checkpoint', 'checkpoints that failed'


class _Copied(NamedTuple):
    """A copied part of the map, with the header of the checkpoint."""

    part: MapPart
    header: MapHeader
    version: int  # of the map when it was copied
    copy_s: float  # time for which the tracker waited for the copy


class CheckpointThread:
    """Writes what has changed in the map about every `period_s`, in a thread of low priority."""

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
        # While True, nothing is written, because the camera is searched for in the stored map.
        self.is_paused = False
        # Whether the session continues the stored map; otherwise, the stored map is kept.
        self.continues_stored = False
        self._writer: MapWriter | None = None
        # Version of the map whose last checkpoint was committed; None: there is none.
        self._written: int | None = None
        self._lock = RLock()  # guards the database and its writer
        self._is_writing = Lock()  # held by the only thread besides the node's that may write
        self._is_ended = Event()
        diagnostics.set_count(_FAILED, 0)
        diagnostics.set_value(_VALUE, 'none yet')
        Thread(target=self._run, name='checkpoints', daemon=True).start()

    def end(self) -> None:
        self._is_ended.set()

    def keep(self) -> None:
        """Rename the stored map to a saved map, which no node resumes as a checkpoint.

        Unless `is_paused`, the latest changes are written to it first.
        """
        with self._lock:  # what another thread is writing now must not reach the database later
            try:
                if self._writer is not None:
                    self._writer.abort()
                if not self.is_paused:
                    self._write(is_last=True)
            except Exception as error:  # noqa: BLE001 - the checkpoint before is kept
                self._report_failure(error)
            self._use_writer(None)
            self.is_paused = self.continues_stored = False
            self._keep_stored()

    def copy_to(self, path: Path) -> bool:
        """Write what has changed, then copy the stored map; return False if there is none.

        It must be called in another thread than the node's.

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
        """Rename the stored map; return False, after logging why, if that is not possible."""
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
        os.setpriority(os.PRIO_PROCESS, get_native_id(), _NICE)  # of this thread alone
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
        """Write what has changed in the map, and return the time [s] that writing took.

        With `is_last`, this is the node's thread, which does not wait between parts of the map.
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
                writer.abort()  # does nothing after the last part
        return wrote_s

    def _begin(self) -> tuple[MapWriter, MapHeader | None] | None:
        """Return the writer of the next checkpoint; None if none is due. Runs between images.

        If the map has not changed since the last checkpoint, its header is returned as well, and
        only the header is written.
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
        """Begin the transaction of a checkpoint; return False if there is nothing to copy."""
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
        """Copy the next part of the map; None if the map was discarded. Runs between images."""
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
        """Write a part of the map; return False without writing if the map was discarded."""
        with self._lock:
            if writer is not self._writer or not writer.is_open:
                return False
            if writer.append(copied.part, copied.header):
                self._written = copied.version  # only now: a full disk refuses the transaction
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
