"""Services that save maps and trajectory, load a map, and end or go on with mapping.

They have a thread of their own: the tracker copies the map, or takes one over, between two images,
and waits neither for files nor for the mapper: that thread does.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from hoid_msgs.srv import LoadMap, SaveMap, SaveTrajectory, SetMode
from rclpy.node import Node

from hoid_common import topics
from hoid_common.errors import InputError
from hoid_common.io.trajectory_io import write_tum_parts
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.execution.service_thread import ServiceThread
from hoid_common.slam_status import SlamMode
from hoid_common.values import IntArray
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.map_io import map_file
from rgbd_slam.map_io.map_directory import (
    CLOUD,
    GRID,
    MAP,
    TRAJECTORY,
    FileKind,
    path_in,
    shown,
    write_whole,
)
from rgbd_slam.map_io.map_file import MapFile
from rgbd_slam.ros.answers import Responder
from rgbd_slam.ros.between_messages import BetweenMessages
from rgbd_slam.ros.scene.link import SceneLink
from rgbd_slam.scene.dense_mapper import StoredView
from rgbd_slam.scene.dense_state import DenseState
from rgbd_slam.session import SlamSession

T = TypeVar('T')

_MODES = {mode.name.lower(): mode for mode in SlamMode}
_SETTLE_S = 40.0
_LOOK_S = 0.05
_MB = 1e6


class MapServices:
    """Answers in a thread of its own, which no request can end.

    Args:
        node: The SLAM node.
        config: Its parameters.
        session: Gives the session, or raises InputError while there is none.
        room: The dense map's process.
        diagnostics: Of the node.
    """

    def __init__(
        self,
        node: Node,
        config: SlamNodeConfig,
        session: Callable[[], SlamSession],
        room: SceneLink,
        diagnostics: Diagnostics,
    ) -> None:
        self._config = config
        self._session = session
        self._scene = room
        self._between = BetweenMessages(node)
        self._thread = ServiceThread(node)
        responder = Responder(node, diagnostics, self._thread.group)
        for type_, topic, act in (
            (SaveMap, topics.SAVE_MAP, self._save),
            (SaveTrajectory, topics.SAVE_TRAJECTORY, self._save_trajectory),
            (SaveMap, topics.SAVE_CLOUD, self._save_cloud),
            (SaveMap, topics.SAVE_GRID, self._save_grid),
            (LoadMap, topics.LOAD_MAP, self._load),
            (SetMode, topics.SET_MODE, self._set_mode),
        ):
            responder.serve(type_, topic, act)
        self._thread.start(responder.failed)

    def close(self) -> None:
        """End the thread, unless it is at work; then the process' end ends it."""
        self._thread.close()

    def _path(self, name: str, kind: FileKind) -> Path:
        return path_in(self._config.map_directory, name, kind)

    def _save_cloud(self, request: SaveMap.Request) -> str:
        return self._scene.save(cloud_path=self._path(request.name, CLOUD))

    def _save_grid(self, request: SaveMap.Request) -> str:
        return self._scene.save(grid_path=self._path(request.name, GRID))

    def _save(self, request: SaveMap.Request) -> str:
        path = self._path(request.name, MAP)
        content, uids, views = self._between.call(self._copy)
        kept = views() if views is not None else []
        dense = DenseState.of_views(kept, uids, is_halved=True) if kept else None
        whole = content._replace(dense=dense)
        size = map_file.save(path, whole)
        return f'{_said(whole)} written to {path}, {size / _MB:.1f} MB'

    def _copy(self) -> tuple[MapFile, IntArray, Callable[[], list[StoredView]] | None]:
        session = self._session()
        keyframes = session.all_keyframes()
        return session.saved_map(), keyframes.uids, self._scene.views(keyframes)

    def _save_trajectory(self, request: SaveTrajectory.Request) -> str:
        kind = request.kind or SaveTrajectory.Request.FINAL
        path, note = self._path(request.name, TRAJECTORY), ''
        if kind == SaveTrajectory.Request.FINAL and not self._settle():
            note = '; the map was still being adjusted'
        parts = self._between.call(lambda: self._session().trajectory_parts(kind))
        num_poses = write_whole(path, lambda aside: write_tum_parts(aside, parts))
        return f'{num_poses} poses written to {path}{note}'

    def _settle(self) -> bool:
        """Have the map adjusted as a whole, once what runs has ended; return whether it is."""
        end_s = time.monotonic() + _SETTLE_S
        if not self._is_settled_by(end_s):
            return False

        def settle() -> None:
            self._session().map.settle()

        self._between.call(settle)
        return self._is_settled_by(end_s)

    def _is_settled_by(self, end_s: float) -> bool:
        def settled() -> bool | None:
            control = self._session().map
            control.update()
            return control.is_settled or None

        return self._until(settled, end_s) is not None

    def _until(self, act: Callable[[], T | None], end_s: float) -> T | None:
        """Call an act between messages until it gives something; return that, or None at the end.

        Images are tracked meanwhile; this thread waits.
        """
        while (given := self._between.call(act)) is None and time.monotonic() < end_s:
            time.sleep(_LOOK_S)
        return given

    def _load(self, request: LoadMap.Request) -> str:
        path, keep = self._path(request.name, MAP), request.merge
        content = map_file.load(path)

        def take_over() -> str | None:
            session = self._session()
            session.map.update()
            if session.map.queue_length > 0:
                return None  # the node would wait for all that is queued
            loaded = session.load(content, keep=keep)
            return self._scene.load(content.dense, loaded, keep=keep)

        note = self._until(take_over, time.monotonic() + _SETTLE_S)
        if note is None:
            raise InputError('keyframes still wait for the mapper; ask again')
        return f'{_said(content)} loaded from {path}{note}'

    def _set_mode(self, request: SetMode.Request) -> str:
        mode = _MODES.get(request.mode)
        if mode is None:
            raise InputError(f'no mode "{shown(request.mode)}"; use one of {", ".join(_MODES)}')
        self._between.call(lambda: self._session().set_mode(mode))
        if mode is SlamMode.MAPPING:
            return 'mapping: the map grows and is corrected'
        if not self._is_settled_by(time.monotonic() + _SETTLE_S):
            raise InputError('the map is still being adjusted; ask again')
        return 'localization: the map stays as it is'


def _said(content: MapFile) -> str:
    views = 0 if content.dense is None else len(content.dense)
    keyframes, points = len(content.map), len(content.map.position_m)
    return f'{keyframes} keyframes, {points} points and {views} images of the dense map'
