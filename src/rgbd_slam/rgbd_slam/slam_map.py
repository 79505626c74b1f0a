"""The map of the running SLAM together with the mapper that extends it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hoid_common.values import FloatArray, IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.mapper import KeyframeRequest
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.map_change import Redirect
from rgbd_slam.processes.map_loading import MapLoading
from rgbd_slam.processes.mapper_client import InlineMapper, MapperClient
from rgbd_slam.processes.mapper_process import MapperProcess


class SlamMap:
    """The tracker's copy of the map (`atlas`) and the mapper that extends it (`mapper`).

    A mapper in a process of its own changes this copy only during a method call (`update`, or one
    that calls it), so that the caller decides between which two frames the map changes.

    Args:
        atlas: The map, still empty.
        camera: The camera with the configured noise.
        config: Parameters of the core.
        on_redirects: Called by each `update` with the keyframes, if any, that were removed since
            the last call; each redirect gives the parent that replaces a removed keyframe.
        background: True: the mapper runs in a process of its own, as on a robot. False: each
            keyframe is mapped before `insert` returns, so that runs repeat bit for bit.

    Raises:
        MapperStoppedError: The mapping process does not start.
    """

    def __init__(
        self,
        atlas: Atlas,
        camera: StereoCamera,
        config: SlamConfig,
        on_redirects: Callable[[tuple[Redirect, ...]], None],
        *,
        background: bool,
    ) -> None:
        self.atlas = atlas
        mapper = MapperProcess if background else InlineMapper
        self.mapper: MapperClient = mapper(camera, atlas, config)
        self.is_growing = True  # False: localization, no keyframe is inserted
        self._on_redirects = on_redirects
        self._on_loaded: Callable[[], None] | None = None  # while a saved map is on its way
        self._is_leaving = False  # whether that map will replace the running one
        self._next_map_id = 0  # the id of a map that was merged into another is not used again
        self._next_uid = 0  # uid of the next keyframe

    @property
    def is_empty(self) -> bool:
        """Return whether the map has no keyframe, not even one that waits for the mapper."""
        return len(self.atlas.keyframes) == 0 and not self.atlas.pending

    def start(self, frame: Frame, T_map_camera: FloatArray) -> int:
        """Start another map beside the existing ones and return the uid of its first keyframe."""
        uid = self.take_uids(1)
        self.mapper.start_map(uid, frame, T_map_camera, self._next_map_id)
        self._next_map_id += 1
        return uid

    def take_uids(self, count: int) -> int:
        """Reserve `count` successive uids for new keyframes, and return the first of them.

        Keyframes get their uids before the mapper inserts them, so that frames can refer to them.
        """
        self._next_uid += count
        return self._next_uid - count

    def insert(self, request: KeyframeRequest) -> None:
        """Send a keyframe to the mapper, and apply the changes that the mapper has finished.

        The keyframe is in `atlas.pending` until the mapper has inserted it.

        Raises:
            MapperStoppedError: As in `update`.
        """
        self.mapper.insert(request)
        self.update()

    def update(self) -> None:
        """Apply the changes that the mapper has finished, without waiting for unfinished ones.

        Removed keyframes are passed to `on_redirects`. If a saved map is loaded, the function that
        `begin_load` was given is called.

        Raises:
            MapperStoppedError: The mapping process has ended for good, does not respond, or a
                saved map could not be restored.
        """
        self.mapper.update()
        self._on_redirects(self.atlas.redirects.take())
        if self._on_loaded is not None and not self.mapper.is_loading:
            on_loaded, self._on_loaded = self._on_loaded, None
            self._is_leaving = False
            self._count_maps()
            on_loaded()

    def _count_maps(self) -> None:
        keyframes = self.atlas.keyframes
        self._next_map_id = 1 + int(keyframes.map_id[keyframes.alive].max())

    def finish(self) -> None:
        """Wait until every inserted keyframe is mapped and global adjustment has ended.

        The last global adjustment is repeated first if keyframes have been added since then; see
        `LoopCloser.settle`. If an adjustment does not end within a time limit, a warning is logged
        and it is not awaited.

        Raises:
            MapperStoppedError: As in `update`.
        """
        self.mapper.finish()
        self.update()

    @property
    def is_loading(self) -> bool:
        """Return whether a saved map is being loaded that is not in the map yet."""
        return self._on_loaded is not None

    @property
    def takes_keyframes(self) -> bool:
        """Return whether keyframes may be inserted now.

        None is inserted into a map that a saved one is about to replace.
        """
        return self.is_growing and not self._is_leaving

    def begin_load(self, loading: MapLoading, on_loaded: Callable[[IntArray], None]) -> int:
        """Begin to load a saved map; return the uid of its first keyframe.

        Tracking continues in the running map meanwhile. Unless it is kept, it gets no new
        keyframes, and in any case no map is started. Another thread must call `loading.restore`
        with that uid; an `update` then exchanges the maps. A mapper in this process exchanges them
        before this call returns.

        Args:
            loading: The saved map. If it keeps the running map, the mapper must be settled.
            on_loaded: Called by the `update` after the exchange, or the one that makes it, with
                the (K,) uids of the saved keyframes.
        """
        first_uid = self.take_uids(len(loading))
        uids = first_uid + np.arange(len(loading))
        self._on_loaded = lambda: on_loaded(uids)
        self._is_leaving = not loading.keeps_running
        self.mapper.begin_load(loading, first_uid)
        return first_uid

    def finish_load(self, loading: MapLoading, first_uid: int) -> None:
        """Restore the map of `begin_load`, which returned `first_uid`; wait until it is loaded.

        Raises:
            MapperStoppedError: As in `update`, or the mapping process takes too long.
        """
        self.mapper.finish_load(loading, first_uid)
        self.update()
