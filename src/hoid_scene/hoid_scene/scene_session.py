"""The scene of a SLAM session: it begins, loads and saves together with the SLAM node's map."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from hoid_common.errors import HoidError, InputError
from hoid_common.poses.keyframe_poses import SessionKeyframes
from hoid_scene.config.scene_config import SceneConfig
from hoid_scene.dense.view_store import ViewStore
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.store import scene_file
from hoid_scene.store.scene_file import SavedScene
from hoid_scene.store.scene_store import SceneStore

_LOG = logging.getLogger(__name__)


class SceneSession:
    """Creates, restores and saves the scene mapper of the present session.

    If the store has the scene of this session, as after a crash of this process, it is restored
    from there. The same happens if the SLAM node crashed and continues its map in a new session.

    Attributes:
        mapper: The scene mapper; None: the camera is not known yet, or all maps are off.
        stamp_ns: Stamp of the latest image that was used; 0: none yet.
        problem: Why the scene of a loaded map was left out, or why the scene is not stored; '':
        no problem.
    """

    def __init__(
        self,
        config: SceneConfig,
        store: SceneStore,
        on_begin: Callable[[SessionKeyframes], None],
    ) -> None:
        self._config, self._store, self._on_begin = config, store, on_begin
        self.known: SessionKeyframes | None = None  # keyframes of the last message
        self.mapper: SceneMapper | None = None
        self.stamp_ns = 0
        self._num_loaded = 0  # number of map files whose scene is in the mapper
        self.problem = ''

    def update(self, known: SessionKeyframes) -> None:
        """Follow the keyframes of the SLAM node: correct the scene, load a map, or begin anew."""
        is_other = self.known is None or known.session != self.known.session
        self.known = known
        if is_other:
            self._begin(known)
        elif self.mapper is not None:
            self.mapper.is_map_level = known.is_level
            self.mapper.correct(known.keyframes)
            self._load(known)

    def add_to_map(self, path: Path, saved: SessionKeyframes) -> str:
        """Add the scene to a map file that the SLAM node is saving; return a summary.

        InputError if the keyframes are of another session. MapFileError if writing fails.
        """
        if self.known is None or saved.session != self.known.session:
            raise InputError(
                'the keyframes of this map have not arrived at hoid_scene yet; try again'
            )
        scene = SavedScene()
        if self.mapper is not None:
            self.mapper.correct(saved.keyframes)
            scene = scene_file.exported(self.mapper, saved.keyframes.uids)
            scene_file.add_to_file(path, scene)
        return scene.summary

    def store_objects(self) -> None:
        if self.mapper is not None and self._config.object_map.enabled:
            self._store.put_objects(self.mapper.object_map, self.mapper.dense.keyframes.uids)

    def _begin(self, known: SessionKeyframes) -> None:
        self.mapper, self.problem = None, ''
        if known.camera is not None:
            is_stored, views = self._stored_views(known)
            config = self._config
            self.mapper = SceneMapper(
                known.camera,
                config.dense,
                config.objects,
                config.object_map,
                is_map_level=known.is_level,
                views=views,
            )
            self.mapper.correct(known.keyframes)
            stored = self._store.session
            self._num_loaded = 0 if stored is None else stored.num_loaded
            if is_stored:
                self._restore(self.mapper)
            self._load(known)
        self._on_begin(known)

    def _stored_views(self, known: SessionKeyframes) -> tuple[bool, ViewStore | None]:
        """Return whether the scene of a session is stored, and the store of its images.

        On a disk that cannot be written, the images are in a temporary store (None).
        """
        try:
            if self._is_stored(known):
                return True, self._store.views()
            return False, self._store.begin(known.session)
        except HoidError as error:
            self.problem = f'a crash would lose the scene, which cannot be stored: {error}'
            _LOG.warning('%s', self.problem)
            return False, None

    def _is_stored(self, known: SessionKeyframes) -> bool:
        """Return whether the stored scene is that of this session, or is continued by it."""
        stored, loaded = self._store.session, known.loaded
        if stored is not None and stored.name == loaded.source:
            self._store.rename(known.session, loaded.saved_uids, loaded.loaded_uids)
            return True
        return stored is not None and stored.name == known.session

    def _restore(self, mapper: SceneMapper) -> None:
        scene = self._store.loaded()
        scene_file.load(mapper, scene)
        self._store.restore(mapper.object_map)
        mapper.dense.restore()
        _LOG.info('the scene of the process that was killed is restored: %s', scene.summary)

    def _load(self, known: SessionKeyframes) -> None:
        mapper, loaded = self.mapper, known.loaded
        if mapper is None or loaded.number <= self._num_loaded:
            return
        scene, path = SavedScene(), Path(loaded.source)
        try:
            if path.is_absolute():  # otherwise it is a session whose scene is not in the store
                saved = scene_file.read_file(path)
                scene = saved.renamed(loaded.saved_uids, loaded.loaded_uids)
                scene_file.load(mapper, scene)
        except HoidError as error:
            self.problem = f'the scene of the loaded map is left out: {error}'
            _LOG.warning('%s', self.problem)
        self._num_loaded = loaded.number
        uids = mapper.dense.keyframes.uids
        self._store.add_loaded(scene, loaded.number, mapper.object_map, uids)
