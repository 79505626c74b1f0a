"""Checkpoints of the map, with which a node that was killed resumes (decisions 030 and 042)."""

from __future__ import annotations

import operator
import os
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from threading import Event, RLock, Thread, get_native_id
from typing import NamedTuple

from rclpy.node import Node

from hoid_common.errors import HoidError, InputError, MapFileError
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.slam_status import SlamMode, SlamState
from hoid_common.values import NS_PER_S
from hoid_scene.dense.submap_export import ExportMark
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.map_io.checkpoint import CheckpointWriter
from rgbd_slam.map_io.checkpoint_folder import Checkpoint, CheckpointFolder
from rgbd_slam.map_io.map_parts import MapPart
from rgbd_slam.ros.map_loader import MapLoader
from rgbd_slam.ros.node_thread import NodeThread
from rgbd_slam.ros.scene.messages import SceneExport
from rgbd_slam.session import Processed, SlamSession
from rgbd_slam.store.tables import MapHeader

# Chosen: the first checkpoint is written after this time, the others at doubling intervals up to
# `checkpoint_period_s`.
_FIRST_S = 1.0
_MAX_SHARE = 0.05  # chosen: largest share of the time that is spent on writing
# Chosen: largest share of the tracker's time that is spent on copying a large map in parts.
_MAX_COPY_SHARE = 0.2
_NICE = 10  # lower priority than tracking and mapping (decision 016)
# Chosen: time (of image stamps) for which the camera is only relocalized in the old map before a
# new map is started beside it.
_RELOCALIZE_NS = 30 * NS_PER_S
_MS, _MB = 1e3, 1e6
_MAX_AWAY_NS = 600 * NS_PER_S  # chosen: a map that was left earlier is kept by name as well
_SEARCHING = 'resumed after a crash: relocalizing the camera in the map from before'
_FOUND = 'resumed after a crash: the camera is found in the map from before; mapping goes on'
_NOT_FOUND = 'not found in the map from before the crash: a new map is started beside it'
_VALUE, _FAILED = 'checkpoint', 'checkpoints that failed'

ReceiveMaps = Callable[[], SceneExport]
RequestMaps = Callable[[KeyframePoses, ExportMark | None], ReceiveMaps | None]


class _Copied(NamedTuple):
    """A copied part of the map, and what else a checkpoint contains."""

    part: MapPart
    header: MapHeader
    stamp_ns: int  # of the last image that was tracked
    copy_s: float  # time for which the tracker waited for the copy
    # Waits for dense map and object map; None: this is not the last part, or both maps are off.
    receive_maps: ReceiveMaps | None = None


class Checkpoints:
    """Writes the map at intervals, and resumes the map that a killed node has left.

    A map that is not resumed is kept under a name of its own. Nothing of this is done if the
    process does not own the folder.

    Args:
        node: The SLAM node.
        config: Its parameters.
        folder: Its checkpoint.
        diagnostics: Diagnostics of the node.
        session: Returns the session, or None while there is no session.
        request_maps: Requests the object map, and the changes of the dense map since an export;
            returns a function that waits for them, or None if both maps are off.
    """

    def __init__(
        self,
        node: Node,
        config: SlamNodeConfig,
        folder: CheckpointFolder,
        diagnostics: Diagnostics,
        session: Callable[[], SlamSession | None],
        request_maps: RequestMaps,
    ) -> None:
        self._logger = node.get_logger()
        self._diagnostics = diagnostics
        self._find_session, self._request_maps = session, request_maps
        self._node_thread = NodeThread(node)
        self._period_s = config.checkpoint_period_s
        self._is_on, self._folder = folder.is_owned, folder
        self._writer: CheckpointWriter | None = None
        self._is_resumed = False  # whether the session continues the map that is stored
        # Version of the map of which a checkpoint was written or is being written; None: none.
        self._written: int | None = None
        # Whether the checkpoint was written once more after the map had stopped changing. The
        # dense map is some images behind the map, so that the first checkpoint may lack some.
        self._is_dense_written = False
        self._lock = RLock()  # guards the folder and its writer
        # Stamp at which a resumed session stops searching for the camera in the old map; None:
        # there is no such search, or it has ended.
        self._search_end_ns: int | None = None
        self._stored: Future[Checkpoint | None] = Future()
        self._is_ended = Event()
        if not self._is_on:
            self._stored.set_result(None)
            return
        diagnostics.set_count(_FAILED, 0)
        diagnostics.set_value(_VALUE, 'none yet')
        read = partial(self._read, self._stored)
        Thread(target=read, name='read checkpoint', daemon=True).start()
        Thread(target=self._run, name='checkpoints', daemon=True).start()

    @property
    def has_stored(self) -> bool:
        """Wait until the checkpoint of a killed node is read; return whether there is one.

        It is False as well if checkpoints are off, if the checkpoint cannot be read, after
        `keep`, and after a `resume` that returned True.
        """
        return self._stored.result() is not None

    def resume(self, session: SlamSession, stamp_ns: int, loader: MapLoader) -> bool:
        """Load the map of a killed node into a new session; return whether this has begun.

        A map that is loaded within 2 s is in use when the call returns. The session only localizes
        until `finish_resume` returns it to mapping. A map that does not fit the camera is not
        loaded, nor one whose last image is later than `stamp_ns` (a recording is played again). If
        the node was away for over ten minutes, the map is kept under a name of its own as well.

        Args:
            session: The new session.
            stamp_ns: Stamp of the camera info with which the session starts.
            loader: Loads the map, a large one within some seconds in the background.
        """
        stored = self._stored.result()
        if stored is None:
            return False
        away_ns = stamp_ns - stored.stamp_ns
        if away_ns < 0:
            self._logger.warning(
                f'these images are {-away_ns / NS_PER_S:.1f} s older than the map of the node '
                'that ended unexpectedly (a recording played again?): a new map is begun'
            )
            self.discard()
            return False
        try:
            loader.load_first(session, stored.content, lambda: None, extend=True)
        except MapFileError as error:
            self._logger.warning(f'the checkpoint is not used: {error}')
            return False  # it is kept, because a corrected camera info that fits it may follow
        self._forget_stored()
        session.slam.map.is_growing = False
        self._search_end_ns = stamp_ns + _RELOCALIZE_NS
        self._is_resumed = True
        if away_ns > _MAX_AWAY_NS:
            self._keep_stored(is_copy=True)
        self._logger.warning(
            f'SLAM ended unexpectedly {away_ns / NS_PER_S:.1f} s ago: relocalizing the camera in '
            f'its map of {len(stored.content.map)} keyframes'
        )
        return True

    def finish_resume(self, session: SlamSession, done: Processed) -> Processed:
        """Switch the session to mapping once the camera is found or the search has taken too long.

        Args:
            session: The session.
            done: The results of the latest image.

        Returns:
            The same results. During a resume, their status has the present mode, and a message
            about the relocalization.
        """
        if self._search_end_ns is None:
            return done
        if session.slam.map.is_loading:
            self._search_end_ns = max(self._search_end_ns, session.stamp_ns + _RELOCALIZE_NS)
        is_found = done.status.state is SlamState.TRACKING
        message = _SEARCHING
        if is_found or session.stamp_ns > self._search_end_ns:
            self._search_end_ns = None
            session.set_mode(SlamMode.MAPPING)
            message = _FOUND if is_found else _NOT_FOUND
            self._logger.warning(message)
        return done._replace(status=replace(done.status, mode=session.mode, message=message))

    def keep(self) -> None:
        """Keep the map under a name of its own, which the log says, so that no node resumes it.

        What has changed since the last checkpoint is written first, unless the camera is still
        searched for in it. Call this in the node's thread, while the session still exists.
        """
        is_searching, self._search_end_ns = self._search_end_ns is not None, None
        if not self._is_on:
            return
        with self._lock:  # what another thread is writing now must not reach the folder later
            try:
                if not is_searching:
                    self._write(is_last=True)
            except Exception as error:  # noqa: BLE001 - the checkpoint before is kept
                self._report_failure(error)
            self._use_writer(None)
            self._is_resumed = False
            self._keep_stored()

    def discard(self) -> None:
        """Keep the map as `keep` does, and resume no map of a killed node, as after a reset."""
        self._forget_stored()
        self.keep()

    def close(self, *, is_asked_for: bool) -> None:
        """Write no further checkpoints, and `keep` the map if the end was requested.

        Args:
            is_asked_for: Whether an operator or launch ended the node, and not an error.
        """
        self._is_ended.set()
        if is_asked_for:
            self.keep()
        self._folder.disown()

    def _keep_stored(self, *, is_copy: bool = False) -> bool:
        """Give the stored map a name of its own; return False if that is not possible.

        Both are logged.
        """
        try:
            kept = self._folder.keep(is_copy=is_copy)
        except MapFileError as error:
            self._report_failure(error)
            return False
        if kept:
            self._logger.info(kept)
        return True

    def _read(self, done: Future[Checkpoint | None]) -> None:
        """Read the checkpoint of a killed node; `keep` may have replaced `done` meanwhile."""
        stored = None
        try:
            if note := self._folder.outdated():
                self._logger.warning(note)
            stored = self._folder.read()
        except (HoidError, OSError) as error:
            self._logger.warning(f'the checkpoint is not used: {error}')
        finally:
            done.set_result(stored)

    def _forget_stored(self) -> None:
        self._stored = Future()
        self._stored.set_result(None)

    def _use_writer(self, writer: CheckpointWriter | None) -> None:
        if self._writer is not None:
            self._writer.close()
        self._writer, self._written = writer, None

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

    def _write(self, *, is_last: bool = False) -> float:
        """Write what has changed in the map, and return the time [s] that writing took.

        With `is_last`, this is the node's thread, which does not wait between parts of the map.
        """
        call = operator.call if is_last else self._node_thread.call
        writer = call(self._begin)
        start_s, longest_s, wrote_s = time.monotonic(), 0.0, 0.0
        while writer is not None:
            copied = call(partial(self._copy, writer))
            if copied is None:
                return wrote_s
            longest_s = max(longest_s, copied.copy_s)
            part_s = time.monotonic()
            if not self._append(writer, copied.part):
                return wrote_s
            wrote_s += time.monotonic() - part_s
            if copied.part.keyframes is not None:
                wrote_s += self._finish(writer, copied, longest_s, start_s)
                break
            if not is_last:
                self._is_ended.wait(copied.copy_s / _MAX_COPY_SHARE)
        return wrote_s

    def _begin(self) -> CheckpointWriter | None:
        """Return the writer of the map; None if there is nothing to write. Runs between images.

        While the camera is being relocalized in the old map, the checkpoint of that map is kept.
        If the map has not changed since the last checkpoint, it is written once more for the dense
        map; afterwards only the checkpoint's stamp is updated. The checkpoint of another map is
        kept under a name of its own; if that is not possible, nothing is written.
        """
        session = self._find_session()
        if session is None or self._search_end_ns is not None:
            return None
        atlas = session.slam.map.atlas
        if len(atlas.keyframes) == 0:
            return None
        if self._writer is None or self._writer.parts.atlas is not atlas:
            with self._lock:
                if not self._is_resumed and not self._keep_stored():
                    return None
                self._is_resumed = False
                self._use_writer(CheckpointWriter(self._folder, atlas))
        is_same = atlas.version == self._written
        if is_same and self._is_dense_written:
            self._folder.touch(session.stamp_ns)
            return None
        self._is_dense_written = is_same
        return self._writer

    def _copy(self, writer: CheckpointWriter) -> _Copied | None:
        """Copy the next part of the map; None if the map was discarded. Runs between images.

        After a change of the camera, the session has another map than the writer.
        """
        session = self._find_session()
        if session is None or writer is not self._writer:
            return None
        if session.slam.map.atlas is not writer.parts.atlas:
            return None
        start_s = time.perf_counter()
        robot_map, part = session.robot_map, writer.parts.copy()
        receive_maps = None
        if part.keyframes is not None:
            self._written = part.version
            receive_maps = self._request_maps(robot_map.keyframes(), writer.submaps_since)
        copy_s = time.perf_counter() - start_s
        return _Copied(part, robot_map.header(), session.stamp_ns, copy_s, receive_maps)

    def _append(self, writer: CheckpointWriter, part: MapPart) -> bool:
        """Write a part of the map; return False without writing if the map was discarded."""
        with self._lock:
            if writer is not self._writer:
                return False
            writer.append(part)
            return True

    def _finish(
        self, writer: CheckpointWriter, copied: _Copied, longest_s: float, start_s: float
    ) -> float:
        """Complete a checkpoint; return the time [s] that writing took.

        It first waits for dense map and object map. If the map was discarded, nothing is written.

        Args:
            writer: The writer, to which the last part was appended.
            copied: This part.
            longest_s: The longest time for which the tracker has waited for a copy.
            start_s: When the checkpoint was begun (monotonic clock).
        """
        maps, are_known = SceneExport(None, None), True
        try:
            maps = copied.receive_maps() if copied.receive_maps else maps
        except InputError:  # the scene process has just ended, or is late
            are_known = False
        finish_s = time.monotonic()
        keyframes = copied.part.keyframes
        assert keyframes is not None
        with self._lock:
            if writer is not self._writer:
                return 0.0
            written = writer.finish(
                copied.header,
                keyframes,
                maps.submaps,
                copied.stamp_ns,
                objects=maps.objects,
                keep_submaps=not are_known,
            )
        text = (
            f'{len(keyframes.rows)} keyframes, {writer.num_voxels} voxels, '
            f'{written / _MB:.1f} of {writer.total_bytes / _MB:.1f} MB written in '
            f'{time.monotonic() - start_s:.2f} s, copied in at most {_MS * longest_s:.1f} ms each'
        )
        self._diagnostics.set_value(_VALUE, text)
        self._diagnostics.clear_problem(_FAILED)
        return time.monotonic() - finish_s

    def _report_failure(self, error: Exception) -> None:
        self._written = None
        self._diagnostics.count(_FAILED)
        text = (
            f'the map cannot be stored to resume it after a crash: {" ".join(str(error).split())}'
        )
        self._diagnostics.set_problem(_FAILED, text)
