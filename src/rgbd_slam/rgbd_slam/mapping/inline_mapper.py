"""The mapper in the tracker's process, with the interface of `MapperProcess`."""

from __future__ import annotations

from rgbd_slam.mapping.map_loading import MapLoading
from rgbd_slam.mapping.mapper import Mapper


class InlineMapper(Mapper):
    """A mapper that completes each request before the call returns, so that runs repeat."""

    queue_length = 0
    waiting_s = 0.0
    num_restarts = 0
    is_settled = True
    is_loading = False

    def begin_load(self, loading: MapLoading) -> None:
        self.load(
            loading.state, loading.first_uid, keep=loading.keeps_running, loops=loading.loops
        )

    def finish_load(self, loading: MapLoading) -> None:
        """Do nothing: the map is loaded already."""

    def update(self) -> None:
        """Do nothing: the tracker and the mapper share one map."""

    def settle(self) -> None:
        """Repeat the last global adjustment if keyframes have been added to the map since then."""
        self.closer.settle(0.0)

    def finish(self) -> None:
        self.settle()
