"""Resumption of the map of a killed node; every map is kept (decision 054)."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Thread

from rclpy.node import Node

from hoid_common.errors import HoidError, MapFileError, counted
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.slam_status import SlamMode, SlamState
from hoid_common.values import NS_PER_S
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.ros.checkpoint_thread import CheckpointThread
from rgbd_slam.ros.map_loader import MapLoader
from rgbd_slam.session import Processed, SlamSession
from rgbd_slam.store.map_file import MapFile
from rgbd_slam.store.running_map import RunningMap

# Chosen: for this time, by image stamps, the camera is only relocalized in the old map; then a new
# map is started beside it.
_RELOCALIZE_NS = 30 * NS_PER_S
_SEARCHING = 'resumed after a crash: relocalizing the camera in the map from before'
_FOUND = 'resumed after a crash: the camera is found in the map from before; mapping goes on'
_NOT_FOUND = 'not found in the map from before the crash: a new map is started beside it'


class Checkpoints:
    """Writes the map at intervals, and resumes the map of a killed node.

    A map that is not resumed is kept under another name.
    """

    def __init__(
        self,
        node: Node,
        config: SlamNodeConfig,
        running: RunningMap,
        diagnostics: Diagnostics,
        session: Callable[[], SlamSession | None],
    ) -> None:
        self._logger = node.get_logger()
        self._running, self._find_session = running, session
        self._thread: CheckpointThread | None = None
        # Stamp at which a resumed session stops relocalizing in the old map; None: it does not.
        self._search_end_ns: int | None = None
        self._stored: Future[MapFile | None] = Future()
        if not running.is_owned:
            self._stored.set_result(None)
            return
        read = partial(self._read, self._stored)
        Thread(target=read, name='read checkpoint', daemon=True).start()
        self._thread = CheckpointThread(
            node, config.checkpoint_period_s, running, diagnostics, session
        )

    @property
    def has_stored(self) -> bool:
        """Wait until the checkpoint of a killed node is read; return whether it can be resumed."""
        return self._stored.result() is not None

    def resume(self, session: SlamSession, stamp_ns: int, loader: MapLoader) -> bool:
        """Load the map of a killed node into a new session; return whether loading has begun.

        The session only localizes until `finish_resume` switches it to mapping. A map is not
        loaded if it does not fit the camera, or if its last image is later than `stamp_ns` (a
        replayed recording).
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
            loader.load_first(session, stored, stored.session, lambda: None, extend=True)
        except MapFileError as error:
            self._logger.warning(f'the checkpoint is not used: {error}')
            # The map is kept, because a corrected camera_info that fits it may follow.
            return False
        self._forget_stored()
        session.map.is_growing = False
        self._search_end_ns = stamp_ns + _RELOCALIZE_NS
        assert self._thread is not None
        self._thread.is_paused = self._thread.continues_stored = True
        self._logger.warning(
            f'SLAM ended unexpectedly {away_ns / NS_PER_S:.1f} s ago: relocalizing the camera in '
            f'its map of {counted(len(stored.map), "keyframe")}'
        )
        return True

    def finish_resume(self, session: SlamSession, done: Processed) -> Processed:
        """Switch the session to mapping once the camera is localized, or after 30 s."""
        if self._search_end_ns is None:
            return done
        if session.map.is_loading:
            self._search_end_ns = max(self._search_end_ns, session.stamp_ns + _RELOCALIZE_NS)
        is_found = done.status.state is SlamState.TRACKING
        message = _SEARCHING
        if is_found or session.stamp_ns > self._search_end_ns:
            self._search_end_ns = None
            session.set_mode(SlamMode.MAPPING)
            message = _FOUND if is_found else _NOT_FOUND
            if self._thread is not None:
                self._thread.is_paused = False
                # False: the stored map is kept under another name.
                self._thread.continues_stored = is_found
            self._logger.warning(message)
        return done._replace(status=replace(done.status, mode=session.mode, message=message))

    def keep(self) -> None:
        """Keep the map under another name, so that no node resumes it."""
        self._search_end_ns = None
        if self._thread is not None:
            self._thread.keep()
            return
        session = self._find_session()
        if session is None or session.mode is not SlamMode.MAPPING:
            return
        if number := len(session.map.atlas.keyframes):
            self._logger.warning(
                f'map of {counted(number, "keyframe")} is not kept, because the node stores none '
                '(checkpoint_period_s is 0, or it began in localization): call save_map first'
            )

    def copy_to(self, path: Path) -> bool:
        """Update and copy the stored map, as `CheckpointThread.copy_to`; False: none is stored."""
        return self._thread is not None and self._thread.copy_to(path)

    def discard(self) -> None:
        """End this map for a reset: `keep` it, and do not resume the map of a killed node."""
        self._forget_stored()
        self.keep()

    def close(self, *, is_asked_for: bool) -> None:
        """Stop writing checkpoints, and `keep` the map unless an error has ended the node."""
        if self._thread is not None:
            self._thread.end()
        if is_asked_for:
            self.keep()
        self._running.disown()

    def _read(self, done: Future[MapFile | None]) -> None:
        """Read a killed node's checkpoint into `done`, which `keep` may replace meanwhile."""
        stored = None
        try:
            if note := self._running.outdated():
                self._logger.warning(note)
            stored = self._running.read()
        except (HoidError, OSError) as error:
            self._logger.warning(f'the checkpoint is not used: {error}')
        finally:
            done.set_result(stored)

    def _forget_stored(self) -> None:
        self._stored = Future()
        self._stored.set_result(None)
