"""The map of the running SLAM together with the mapper that extends it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hoid_common.values import FloatArray, IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.mapper import KeyframeRequest
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.map_change import Redirect
from rgbd_slam.model.map_state import MapState
from rgbd_slam.processes.mapper_client import InlineMapper, MapperClient
from rgbd_slam.processes.mapper_process import MapperProcess


class SlamMap:
    """The tracker's copy of the map (`atlas`) and the mapper that extends it (`mapper`).

    Reading an attribute never changes the map; only calls do, so that a caller decides between
    which two frames it changes.

    Args:
        atlas: The map, still empty.
        camera: The camera with the configured noise.
        config: Parameters of the core.
        on_redirects: Called with the redirects of removed keyframes after each change of the map.
            Poses that were stored relative to such a keyframe must be attached to its parent.
        background: Map in a separate process, as live. Otherwise each keyframe is mapped before
            the call returns, so that runs repeat bit for bit.
    """

    def __init__(
        self,
        atlas: Atlas,
        camera: StereoCamera,
        config: SlamConfig,
        on_redirects: Sequence[Callable[[tuple[Redirect, ...]], None]],
        *,
        background: bool,
    ) -> None:
        self.atlas = atlas
        mapper = MapperProcess if background else InlineMapper
        self.mapper: MapperClient = mapper(camera, atlas, config)
        self.is_growing = True  # False: localization, no keyframe is inserted
        self._on_redirects = on_redirects
        self._next_map_id = 0  # the ids of merged maps are not used again

    @property
    def is_empty(self) -> bool:
        """Return whether the map has no keyframe yet."""
        return len(self.atlas.keyframes) == 0

    def start(self, frame: Frame, T_map_camera: FloatArray) -> int:
        """Start another map beside the existing ones and return the row of its first keyframe."""
        i = self.mapper.start_map(frame, T_map_camera, self._next_map_id)
        self._next_map_id += 1
        return i

    def insert(self, request: KeyframeRequest) -> int | None:
        """Insert a keyframe; return its row, or None if the mapper runs in the background."""
        i = self.mapper.insert(request)
        self.update()
        return i

    def update(self) -> None:
        """Apply the changes that the mapper has finished, without waiting for others."""
        self.mapper.update()
        redirects = self.atlas.redirects.take()
        for on_redirects in self._on_redirects:
            on_redirects(redirects)

    def finish(self) -> None:
        """Wait until every inserted keyframe is mapped and the whole map has been adjusted."""
        self.mapper.finish()
        self.update()

    def load(self, state: MapState, *, keep: bool) -> IntArray:
        """Load a saved map and return the (K,) uids of its keyframes.

        Args:
            state: The saved map.
            keep: Keep the running map beside the saved one until a recognized place merges the
                two; otherwise the running map is discarded.
        """
        self.mapper.load(state, keep=keep)
        self.update()
        keyframes = self.atlas.keyframes
        self._next_map_id = 1 + int(keyframes.map_id[keyframes.alive].max())
        return np.sort(keyframes.uid[keyframes.alive])[-len(state) :]
