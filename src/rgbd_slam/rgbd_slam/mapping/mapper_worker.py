"""The mapping process, which receives keyframes and sends back the changed rows of the map.

It ends after the request in progress when the pipe from the tracker closes, also because the
tracker was killed.
"""

from __future__ import annotations

import os
from multiprocessing.connection import Connection
from typing import NamedTuple

from hoid_common.values import FeatureVerdicts, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closer import LoopCounts
from rgbd_slam.mapping.mapper import KeyframeRequest, Mapper
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.model.map_change import MapChange
from rgbd_slam.model.map_state import MapState
from rgbd_slam.records.shared_record import RecordLocation

_NICE = 5  # priority below tracking, which does not wait for the mapper (decision 016)
_IDLE_S = 0.2  # chosen: period in which an idle mapper polls its background adjustment


class Start(NamedTuple):
    """Request: create the first keyframe of a map."""

    uid: int  # uid of the keyframe
    frame: Frame
    T_map_camera: FloatArray  # (4, 4)
    map_id: int


class Resume(NamedTuple):
    """Request: continue with the map of a mapping process that has died."""

    whole: MapChange  # all keyframes and points of the tracker's copy
    loops: LoopCounts


class Settle(NamedTuple):
    """Request: repeat the last global adjustment if the map has grown; see `LoopCloser.settle`."""

    limit_s: float  # limit of the wait for a running adjustment, and then for this one


class Load(NamedTuple):
    """Request: load a saved map."""

    state: MapState | RecordLocation  # the saved map, or its location in shared memory
    first_uid: int  # uid of the first saved keyframe; the others get the next ones
    keep: bool  # True: keep the running map beside it; False: discard the running map
    loops: tuple[LoopEdge, ...]  # loop edges, between rows of the saved map


Request = Start | Load | Resume | Settle | KeyframeRequest | FeatureVerdicts


class Ready(NamedTuple):
    """Report: the process has started and accepts requests."""


class Loaded(NamedTuple):
    """In a report: the mapper has loaded a saved map, which the tracker restores itself."""

    version: int  # version of the new map, after which the tracker needs all changes
    # Offset from the tracker's uids of points, which count from 0, to the mapper's. It is 0 if the
    # running map was kept, because both processes then continue its uids.
    uid_offset: int


class MapperReport(NamedTuple):
    """Report: the changes of the map since the last report.

    It is sent after each request, and also when a background adjustment was applied or failed.
    """

    change: MapChange | Loaded  # `Loaded` after a `Load`
    loops: LoopCounts  # numbers of loops and merges so far
    completes_request: bool  # False: the report is about a background adjustment
    is_settled: bool  # whether no background adjustment is running


class MapperServer:
    """Carries out a tracker's requests with a mapper, in the process that calls it.

    With `background`, global adjustment runs in a separate process.
    """

    def __init__(
        self, camera: StereoCamera, config: SlamConfig, *, background: bool = True
    ) -> None:
        self.map = Atlas(config.camera.scale_factor, config.camera.num_octaves)
        self._mapper = Mapper(camera, self.map, config, background=background)
        self._version = 0  # version of the map at the last report

    def serve(self, request: Request) -> MapperReport:
        mapper = self._mapper
        match request:
            case KeyframeRequest():
                mapper.insert(request)
            case FeatureVerdicts():
                mapper.retract(request)
            case Settle(limit_s):
                mapper.closer.settle(limit_s)
            case Resume(whole, loops):
                mapper.resume(whole, loops)
                self._version = whole.version  # the tracker has this version already
            case Load(state, first_uid, keep, loops):
                state = state.map() if isinstance(state, RecordLocation) else state
                mapper.load(state, first_uid, keep=keep, loops=loops)
                return self._report_loaded(keep=keep)
            case Start():
                mapper.start_map(*request)
        has_features = isinstance(request, KeyframeRequest | Start)
        return self._report(completes_request=True, has_features=has_features)

    def poll(self) -> MapperReport | None:
        """Apply a finished background adjustment and report it; None if none has finished."""
        was_adjusting = self._mapper.closer.adjuster.is_running
        is_applied = self._mapper.closer.adjuster.poll()
        has_ended = was_adjusting and not self._mapper.closer.adjuster.is_running
        return self._report(completes_request=False) if is_applied or has_ended else None

    def close(self) -> None:
        self._mapper.close()

    def _report_loaded(self, *, keep: bool) -> MapperReport:
        points = self.map.points
        self._version = self.map.skip_changes()
        loaded = Loaded(self._version, 0 if keep else int(points.uid[points.alive].min()))
        return MapperReport(
            loaded, self._mapper.loops, True, not self._mapper.closer.adjuster.is_running
        )

    def _report(self, *, completes_request: bool, has_features: bool = False) -> MapperReport:
        change = self.map.changes_since(self._version, with_features=not has_features)
        self._version = change.version
        is_settled = not self._mapper.closer.adjuster.is_running
        return MapperReport(change, self._mapper.loops, completes_request, is_settled)


def run_mapper(
    requests: Connection, reports: Connection, camera: StereoCamera, config: SlamConfig
) -> None:
    """Serve requests until a pipe closes; this is the main function of the process."""
    os.nice(_NICE)
    server = MapperServer(camera, config)
    try:
        reports.send(Ready())
        while True:
            has_request = requests.poll(_IDLE_S)
            report = server.serve(requests.recv()) if has_request else server.poll()
            if report is not None:
                reports.send(report)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        pass  # the tracker has ended or was killed, maybe while this process was starting
    finally:
        server.close()
