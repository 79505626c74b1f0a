"""The life of a map: begun, extended, adjusted, replaced by a saved one, ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hoid_common.values import FeatureVerdicts, FloatArray, IntArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closing import LoopCounts
from rgbd_slam.mapper import KeyframeRequest
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.model.map_change import Redirect
from rgbd_slam.model.map_state import MapState, snapshot
from rgbd_slam.model.trajectory import keyframe_poses, main_map
from rgbd_slam.processes.mapper_link import InlineMapper, MapperLink
from rgbd_slam.processes.mapper_process import MapperProcess


class MapControl:
    """Owns the map and who extends it; whoever steers the map's life is handed this object.

    The map changes in its methods only, and never in a property.

    Args:
        atlas: The map, empty.
        camera: The camera, with the configured noise.
        config: Parameters.
        background: Map in a process of its own, as live; otherwise at once, so that runs repeat.
        followers: Told where poses hang now that were relative to keyframes that have left.
    """

    def __init__(
        self,
        atlas: Atlas,
        camera: StereoCamera,
        config: SlamConfig,
        followers: Sequence[Callable[[tuple[Redirect, ...]], None]],
        *,
        background: bool,
    ) -> None:
        self.atlas = atlas
        link = MapperProcess if background else InlineMapper
        self._link: MapperLink = link(camera, self.atlas, config)
        self._followers = followers
        self._is_growing = True
        self._num_maps = 0  # of all time: ids are not used again

    @property
    def is_empty(self) -> bool:
        """Return whether nothing has been mapped."""
        return len(self.atlas.keyframes) == 0

    @property
    def is_growing(self) -> bool:
        """Return whether keyframes are made; otherwise the map stays as it is."""
        return self._is_growing

    @property
    def is_settled(self) -> bool:
        """Return whether the map, as last updated, stays as it is while no keyframe is made."""
        return self._link.is_settled

    @property
    def queue_length(self) -> int:
        """Return how many keyframes wait for the mapper or are being taken in."""
        return self._link.queue_length

    @property
    def num_restarts(self) -> int:
        """Return how often a mapping process had died and was replaced."""
        return self._link.num_restarts

    @property
    def loops(self) -> LoopCounts:
        """Return how many loops were closed, and maps merged."""
        return self._link.loops

    def set_growing(self, *, is_growing: bool) -> None:
        """Let the map grow, or leave it as it is once it `is_settled`."""
        self._is_growing = is_growing

    def start(self, frame: Frame, T_map_camera: FloatArray) -> int:
        """Begin a map beside those there are, and return the row of its first keyframe."""
        i = self._link.start_map(frame, T_map_camera, self._num_maps)
        self._num_maps += 1
        return i

    def insert(self, request: KeyframeRequest) -> int | None:
        """Hand a keyframe over; its row when that has been taken in at once."""
        i = self._link.insert(request)
        self.update()
        return i

    def take_back(self, verdicts: FeatureVerdicts) -> None:
        """Forget what a keyframe saw on what turned out to move."""
        self._link.take_back(verdicts)

    def update(self) -> None:
        """Take in what the mapper has done meanwhile, without waiting."""
        self._link.update()
        redirects = self.atlas.redirects.take()
        for follow in self._followers:
            follow(redirects)

    def settle(self) -> None:
        """Ask for a last adjustment of what has grown; `update` until the map `is_settled`."""
        self._link.settle()

    def finish(self) -> None:
        """Wait until all that was handed over is in the map, and let it settle."""
        self._link.finish()
        self.update()

    def close(self) -> None:
        """End what runs in the background; the map can still be read."""
        self._link.close()

    def state(self) -> MapState:
        """Copy the map, in a few ms."""
        return snapshot(self.atlas)

    def keyframe_poses(self) -> KeyframePoses:
        """Return where the keyframes of all maps are."""
        return keyframe_poses(self.atlas)

    def points_m(self) -> FloatArray:
        """Return (N, 3) points of the main map."""
        points = self.atlas.points
        is_main = points.map_id == main_map(self.atlas.keyframes)
        return np.asarray(points.position_m[points.alive & is_main])

    def load(self, state: MapState, *, keep: bool) -> IntArray:
        """Lay a saved map over the running one and return the (K,) uids of its keyframes.

        Args:
            state: The saved map.
            keep: Leave the running map beside it, until a known place joins the two; otherwise it
                is gone.
        """
        self._link.load(state, keep=keep)
        self.update()
        keyframes = self.atlas.keyframes
        self._num_maps = 1 + int(keyframes.map_id[keyframes.alive].max())
        return np.sort(keyframes.uid[keyframes.alive])[-len(state) :]
