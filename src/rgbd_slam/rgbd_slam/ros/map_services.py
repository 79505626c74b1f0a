"""The services that save and load maps, save the trajectory, and set the mode.

A separate thread runs them, because it waits for files and for the mapper. Everything that uses
the session runs in the tracker's thread, between two images (`NodeThread`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from hoid_msgs.srv import LoadMap, SaveMap, SaveTrajectory, SetMode
from rclpy.node import Node

from hoid_common import topics
from hoid_common.errors import InputError, counted
from hoid_common.io.tum_text import write_tum_parts
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.execution.service_handlers import ServiceHandlers
from hoid_common.ros.execution.service_thread import ServiceThread
from hoid_common.slam_status import SlamMode
from hoid_common.store.database import Database, replaced
from hoid_common.store.map_directory import (
    MAP,
    TRAJECTORY,
    FileKind,
    existing_map,
    path_in,
    printable,
    remove_abandoned,
    write_whole,
)
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.ros.keyframe_outputs import KeyframeOutputs
from rgbd_slam.ros.map_loader import MapLoader
from rgbd_slam.ros.node_thread import NodeThread
from rgbd_slam.ros.scene_client import SceneMapClient
from rgbd_slam.session import SlamSession
from rgbd_slam.store import map_file
from rgbd_slam.store.map_file import MapFile
from rgbd_slam.store.map_parts import MapPart
from rgbd_slam.store.map_writer import MapWriter
from rgbd_slam.store.tables import TABLES, MapHeader

_MODES = {mode.name.lower(): mode for mode in SlamMode}
# Time limit for the end of mapping and global adjustment. Chosen: twice the limit of the mapping
# process for a global adjustment.
_SETTLE_S = 40.0
_MAX_PAUSE_S = 0.05  # chosen: longest pause of writing between two parts of a map
_MB = 1e6


class MapServices:
    """Offers the map services in a separate thread, which survives the failure of a request.

    The service that sets the mode has its own thread, so that a slow disk does not delay it.

    Args:
        keyframes: Returns the message about the keyframes for the scene node.
        copy_stored: Copies the stored map to a new file (`Checkpoints.copy_to`).
    """

    def __init__(
        self,
        node: Node,
        config: SlamNodeConfig,
        session: Callable[[], SlamSession],
        keyframes: KeyframeOutputs,
        loader: MapLoader,
        diagnostics: Diagnostics,
        copy_stored: Callable[[Path], bool],
    ) -> None:
        self._config, self._copy_stored = config, copy_stored
        self._logger = node.get_logger()
        self._session = session
        self._keyframes, self._loader = keyframes, loader
        self._scene = SceneMapClient(node)
        self._node_thread = NodeThread(node)
        self._thread, self._mode_thread = ServiceThread(node), ServiceThread(node)
        handlers = ServiceHandlers(node, diagnostics, self._thread.group)
        for type_, topic, handle in (
            (SaveMap, topics.SAVE_MAP, self._save),
            (SaveTrajectory, topics.SAVE_TRAJECTORY, self._save_trajectory),
            (LoadMap, topics.LOAD_MAP, self._load),
        ):
            handlers.add(type_, topic, handle)
        mode = ServiceHandlers(node, diagnostics, self._mode_thread.group)
        mode.add(SetMode, topics.SET_MODE, self._set_mode)
        self._remove_abandoned()
        for thread in (self._thread, self._mode_thread):
            thread.start(handlers.report_fault)

    def close(self) -> None:
        """End the threads; wait at most two seconds each for the request that runs."""
        for thread in (self._thread, self._mode_thread):
            thread.close()

    def _new_path(self, name: str, kind: FileKind) -> Path:
        """Return the path of a file to write; remove unfinished files of killed processes."""
        self._remove_abandoned()
        return path_in(self._config.map_directory, name, kind)

    def _remove_abandoned(self) -> None:
        directory = self._config.map_directory
        if removed := remove_abandoned(directory):
            self._logger.info(
                f'{directory}: unfinished files of killed processes removed: {", ".join(removed)}'
            )

    def _save(self, request: SaveMap.Request) -> str:
        path = self._new_path(request.name, MAP)
        session = self._node_thread.call(self._session)
        if not self._has_keyframe(session):
            raise InputError('nothing has been mapped yet: there is nothing to save')
        with replaced(path) as aside:
            if not self._copy_stored(aside):
                self._write(aside, session)
            content = map_file.load(aside)  # so that no map is saved that cannot be loaded again
            keyframes = self._node_thread.call(self._keyframes.message)
            if keyframes.session != content.session:
                raise InputError('the map was discarded meanwhile: there is nothing to save')
            scene = self._scene.add_to(aside, keyframes)
            size = aside.stat().st_size
        return f'{_summary(content)}, {scene} written to {path}, {size / _MB:.1f} MB'

    def _write(self, path: Path, session: SlamSession) -> None:
        """Write the session's map to a new file."""
        writer = MapWriter(session.map.atlas, lambda: Database.create(path, TABLES))

        def copy() -> tuple[MapPart, MapHeader]:
            if self._session() is not session:
                raise InputError('the map was discarded meanwhile: there is nothing to save')
            return writer.copy(), session.map.header(session.stamp_ns)

        writer.begin()
        is_complete = False
        while not is_complete:
            start_s = time.perf_counter()
            part, header = self._node_thread.call(copy)
            copy_s = time.perf_counter() - start_s
            is_complete = writer.append(part, header)
            time.sleep(min(copy_s, _MAX_PAUSE_S))  # leaves about half of the time to tracking

    def _save_trajectory(self, request: SaveTrajectory.Request) -> str:
        kind = request.kind or SaveTrajectory.Request.FINAL
        path, note = self._new_path(request.name, TRAJECTORY), ''
        if kind == SaveTrajectory.Request.FINAL and not self._settle():
            note = '; the map was still being adjusted'
        if kind == SaveTrajectory.Request.KEYFRAMES:
            self._has_keyframe(self._node_thread.call(self._session))
        parts = self._node_thread.call(lambda: self._session().map.trajectory_parts(kind))
        written = write_whole(path, lambda aside: write_tum_parts(aside, parts))
        return f'{written} written to {path}{note}'

    def _has_keyframe(self, session: SlamSession) -> bool:
        """Return whether the map has a keyframe; wait for a pending one."""
        atlas = session.map.atlas
        if len(atlas.keyframes) == 0 and atlas.pending:
            self._is_settled_by(time.monotonic() + _SETTLE_S)
        return len(atlas.keyframes) > 0

    def _settle(self) -> bool:
        """Wait for the mapper's requests and a final adjustment; return whether both ended."""
        end_s = time.monotonic() + _SETTLE_S
        if not self._is_settled_by(end_s):
            return False
        session = self._node_thread.call(self._session)
        self._node_thread.call(session.map.mapper.settle)
        return self._is_settled_by(end_s)

    def _is_settled_by(self, end_s: float) -> bool:
        """Wait until the mapper has finished all its work; return False if `end_s` comes first."""

        def settled() -> bool:
            slam_map = self._session().map
            slam_map.update()
            return slam_map.mapper.is_settled

        return self._node_thread.poll(settled, end_s)

    def _load(self, request: LoadMap.Request) -> str:
        path = existing_map(self._config.map_directory, request.name)
        content = map_file.load(path)
        session = self._node_thread.call(self._session)
        extend = session.mode is SlamMode.MAPPING
        self._loader.load(session, content, str(path), keep=request.merge, extend=extend)
        return f'{_summary(content)} loaded from {path}'

    def _set_mode(self, request: SetMode.Request) -> str:
        mode = _MODES.get(request.mode)
        if mode is None:
            name = printable(request.mode)
            raise InputError(f'no mode "{name}"; use one of {", ".join(_MODES)}')
        self._node_thread.call(lambda: self._session().set_mode(mode))
        if mode is SlamMode.MAPPING:
            return 'mapping: the map grows and is corrected'
        if not self._is_settled_by(time.monotonic() + _SETTLE_S):
            return 'localization: the map stays as it is once a running adjustment has ended'
        return 'localization: the map stays as it is'


def _summary(content: MapFile) -> str:
    keyframes, points = len(content.map), len(content.map.position_m)
    summary = f'{counted(keyframes, "keyframe")} and {counted(points, "point")}'
    sizes = np.sort(np.bincount(content.map.map_id))[::-1]
    if len(sizes) > 1:
        summary += (
            f' in {len(sizes)} maps that no recognized place joins yet, of '
            f'{", ".join(map(str, sizes))} keyframes: localization uses the largest'
        )
    return summary
