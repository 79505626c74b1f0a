"""Loading of saved maps into the node's session, while images are tracked.

Reading, checking and restoring a map of 10,000 keyframes takes seconds. Other threads and
processes do it; the tracker's thread only starts it and later exchanges the maps.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from threading import Event, Thread

from rclpy.node import Node

from hoid_common.errors import HoidError, InputError
from hoid_common.values import IntArray
from rgbd_slam.mapping.map_loading import MapLoading
from rgbd_slam.ros.keyframe_outputs import KeyframeOutputs
from rgbd_slam.ros.node_thread import NodeThread
from rgbd_slam.session import SlamSession
from rgbd_slam.store.map_file import MapFile

# Limit of the wait for earlier requests to the mapper. Chosen: twice the limit of the mapping
# process for a global adjustment.
_QUEUE_S = 40.0
# Limit of the loading. Chosen: many times the duration for the largest map, for a busy computer.
_LOAD_S = 600.0
# Chosen: time for which a new session waits for its map. A map of some hundred keyframes is loaded
# by then, so that the first image is relocalized in it.
_PATIENCE_S, _SHORT_POLL_S = 2.0, 0.002


class MapLoader:
    """Loads saved maps; calls `keep_running` before one replaces the running map."""

    def __init__(
        self,
        node: Node,
        session: Callable[[], SlamSession | None],
        keyframes: KeyframeOutputs,
        keep_running: Callable[[], None],
    ) -> None:
        self._logger = node.get_logger()
        self._node_thread = NodeThread(node)
        self._session, self._keyframes, self._keep_running = session, keyframes, keep_running

    def load(
        self, session: SlamSession, content: MapFile, source: str, *, keep: bool, extend: bool
    ) -> None:
        """Load a map and wait until it is in use; called in another thread than the node's.

        Args:
            source: Path of its file, or the session of the crashed node that has mapped it.
            keep: Whether the running map is kept beside it.
            extend: True: the map will be extended; False: only localization.

        Raises:
            MapFileError: The map does not fit the camera; the running map is unchanged.
            InputError: The mapper or the node is too busy, another map is being loaded, or the
                session has ended.
            MapperStoppedError: The mapping process takes too long, or cannot be kept running.
        """
        loading, loaded = session.map.prepare_load(content, keep=keep, extend=extend), Event()
        saved_uids = content.keyframes().uids
        self._poll(
            session,
            lambda: self._begin(session, loading, source, saved_uids, loaded.set),
            _QUEUE_S,
            'keyframes or an adjustment of the map still occupy the mapper; try again',
        )
        self._complete(session, loading, loaded)

    def load_first(
        self,
        session: SlamSession,
        content: MapFile,
        source: str,
        on_loaded: Callable[[], None],
        *,
        extend: bool,
    ) -> None:
        """Load a map into a new session in the node's thread, and wait for it at most 2 s.

        If that is not enough, the map is loaded in the background, and no image is tracked until
        then. Arguments and errors are those of `load`; `on_loaded` is called in the node's thread
        when the map is in use.
        """
        loading, is_loaded = session.map.prepare_load(content, extend=extend), Event()

        def loaded() -> None:
            is_loaded.set()
            on_loaded()

        # The new mapper has no requests yet, so that loading begins at once.
        self._begin(session, loading, source, content.keyframes().uids, loaded)

        def complete() -> None:
            try:
                self._complete(session, loading, is_loaded)
            except HoidError as error:
                self._logger.warning(f'the map is not loaded completely: {error}')

        Thread(target=complete, name='first map', daemon=True).start()
        end_s = time.monotonic() + _PATIENCE_S
        while not is_loaded.is_set() and time.monotonic() < end_s:
            time.sleep(_SHORT_POLL_S)
            session.map.update()

    def _begin(
        self,
        session: SlamSession,
        loading: MapLoading,
        source: str,
        saved_uids: IntArray,
        on_loaded: Callable[[], None],
    ) -> bool:
        """Start loading a map; return False if the mapper is too busy."""
        keep, running = loading.keeps_running, session.map
        if running.is_loading:
            raise InputError('another map is being loaded; try again')
        running.update()
        if running.mapper.queue_length > 0 or (keep and not running.mapper.is_settled):
            return False
        if not keep and len(running.atlas.keyframes) > 0:
            self._keep_running()

        def loaded() -> None:
            self._keyframes.note_loaded(source, saved_uids, loading.uids, keep=keep)
            on_loaded()

        running.begin_load(loading, loaded)
        return True

    def _complete(self, session: SlamSession, loading: MapLoading, loaded: Event) -> None:
        """Restore a map for the tracker, and wait until `loaded` is set, because it is in use."""
        loading.restore()

        def is_loaded() -> bool:
            session.map.update()
            return loaded.is_set()

        late = 'the mapper has not loaded the map in ten minutes; free the computer'
        self._poll(session, is_loaded, _LOAD_S, late)

    def _poll(
        self, session: SlamSession, function: Callable[[], bool], limit_s: float, late: str
    ) -> None:
        """Call a function in the node's thread until it returns True; else InputError `late`."""

        def checked() -> bool:
            if self._session() is not session:
                raise InputError('the map was discarded meanwhile')
            return function()

        if not self._node_thread.poll(checked, time.monotonic() + limit_s):
            raise InputError(late)
