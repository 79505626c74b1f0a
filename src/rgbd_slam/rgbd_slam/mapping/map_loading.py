"""A saved map that is being loaded: the mapper and the tracker's process restore it in parallel.

Another thread of the tracker restores the map from the same temporary file as the mapper, which
both processes map into memory, so that neither has to send its result to the other. The tracker
then exchanges its map for the new one at once.
"""

from __future__ import annotations

from contextlib import suppress
from threading import Event

import numpy as np

from hoid_common.values import CameraModel, IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.mapping.mapper_worker import Load
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import StereoCamera
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.model.map_state import MapState, restore
from rgbd_slam.places.place_finder import PlaceFinder
from rgbd_slam.places.place_index import PlaceIndex
from rgbd_slam.records.shared_record import SharedRecord


class MapLoading:
    """A saved map, in the core's map frame, that replaces the running one or is added to it.

    Any thread may make this object and call `restore`. Afterwards `atlas` is the restored map,
    until the tracker exchanges its contents for those of the running map. A running map that is
    kept must not change until `restore` has ended. `places` makes the index of the restored map in
    advance, so that it does not delay the first relocalization (2 s for 10,000 keyframes).
    """

    def __init__(
        self,
        state: MapState,
        camera: StereoCamera,
        config: SlamConfig,
        *,
        running: Atlas | None = None,
        loops: tuple[LoopEdge, ...] = (),
        places: PlaceFinder | None = None,
        made_with: CameraModel | None = None,
    ) -> None:
        self._camera, self._running, self._places = camera, running, places
        self._octaves = config.camera.scale_factor, config.camera.num_octaves
        self._shared: SharedRecord[MapState] | None = None
        with suppress(OSError):  # the state is sent through the pipe instead
            self._shared = SharedRecord(state)
        self.state = state if self._shared is None else self._shared.record
        self.loops, self.made_with = loops, made_with
        self.first_uid = 0  # of the saved keyframes, which get successive uids
        self._is_restored = Event()
        self.atlas: Atlas | None = None
        self.index: PlaceIndex | None = None

    def __len__(self) -> int:
        return len(self.state)

    @property
    def uids(self) -> IntArray:
        """Return the (K,) new uids of the saved keyframes, in the order of the saved map."""
        return self.first_uid + np.arange(len(self))

    @property
    def keeps_running(self) -> bool:
        return self._running is not None

    def request(self) -> Load:
        source = self.state if self._shared is None else self._shared.location
        return Load(source, self.first_uid, self.keeps_running, self.loops)

    def restore(self) -> None:
        """Restore the map for the tracker, once `SlamMap.begin_load` has set `first_uid`."""
        try:
            atlas = Atlas(*self._octaves)
            if self._running is not None:
                atlas.apply(self._running.whole())
            restore(
                atlas,
                self.state,
                self._camera,
                self.first_uid,
                keep=self.keeps_running,
                loops=self.loops,
            )
            if self._places is not None:
                self.index = self._places.index_of(atlas)
            self.atlas = atlas
        finally:
            self._is_restored.set()

    def wait(self, limit_s: float) -> bool:
        """Wait up to `limit_s` until `restore` has ended or failed; return whether it has."""
        return self._is_restored.wait(limit_s)
