"""Loading of a saved map, which mapper and tracker process restore in parallel.

A thread of the tracker process restores the map from the same temporary file as the mapper. Both
processes map the file into memory, so that neither has to send its result to the other. The
tracker then exchanges its map for the new one at once.
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
    """A saved map that replaces the running map or is added to it.

    Any thread may create this object and call `restore`. Then `atlas` is the restored map, until
    the tracker exchanges its contents for those of the running map. A running map that is kept
    must not change before `restore` has ended. `places` creates the index of the restored map in
    advance, which takes 2 s for 10,000 keyframes, so that the first relocalization is not delayed.
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
        with suppress(OSError):  # without shared memory, the state is sent through the pipe
            self._shared = SharedRecord(state)
        self.state = state if self._shared is None else self._shared.record
        self.loops, self.made_with = loops, made_with
        self.first_uid = 0  # uid of the first saved keyframe; the others get the next ones
        self._is_restored = Event()
        self.atlas: Atlas | None = None
        self.index: PlaceIndex | None = None

    def __len__(self) -> int:
        return len(self.state)

    @property
    def uids(self) -> IntArray:
        """Return the new uids (K,) of the saved keyframes, in the order of the saved map."""
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
        """Wait up to `limit_s` for the end of `restore`; return whether it has ended or failed."""
        return self._is_restored.wait(limit_s)
