"""The mapping process: it receives keyframes and sends back the rows of the map that changed.

It ends when the pipe from the tracker closes, and so outlives neither `close` nor a killed
tracker.
"""

from __future__ import annotations

import os
from multiprocessing.connection import Connection
from typing import NamedTuple

from hoid_common.values import FeatureVerdicts, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closing import LoopCounts
from rgbd_slam.mapper import KeyframeRequest, Mapper
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.map_change import MapChange
from rgbd_slam.model.map_state import MapState

_NICE = 5  # lower priority than tracking, which does not wait for the mapper (decision 016)
_IDLE_S = 0.2  # chosen: how often an idle mapper polls its background adjustment for a result


class Start(NamedTuple):
    """Request: create the first keyframe of a map."""

    uid: int
    frame: Frame
    T_map_camera: FloatArray  # (4, 4)
    map_id: int


class Resume(NamedTuple):
    """Request: continue with the map of a mapping process that has died."""

    whole: MapChange
    loops: LoopCounts


class Settle(NamedTuple):
    """Request: wait for the background adjustment."""

    limit_s: float


class Load(NamedTuple):
    """Request: load a saved map."""

    state: MapState
    first_uid: int  # of its keyframes
    keep: bool  # keep the running map beside it


Request = Start | Load | Resume | Settle | KeyframeRequest | FeatureVerdicts


class Ready(NamedTuple):
    """Report: the process has started and accepts requests."""


class MapperReport(NamedTuple):
    """Report: what changed since the last report, sent after each request and adjustment."""

    change: MapChange
    loops: LoopCounts
    completes_request: bool  # False: the report follows from a background adjustment
    is_settled: bool  # whether no adjustment is running in the background


def run_mapper(
    requests: Connection, reports: Connection, camera: StereoCamera, config: SlamConfig
) -> None:
    """Serve requests until the pipe closes; the main function of the process."""
    os.nice(_NICE)
    atlas = Atlas(config.camera.scale_factor, config.camera.num_octaves)
    mapper = Mapper(camera, atlas, config, background=True)
    version = 0
    reports.send(Ready())
    try:
        while True:
            has_request = requests.poll(_IDLE_S)
            if has_request:
                request = requests.recv()
                _serve(mapper, request)
                if isinstance(request, Resume):  # the tracker has this map already
                    version = request.whole.version
            elif not mapper.poll():
                continue
            change = atlas.changes_since(version)
            version = change.version
            settled = not mapper.is_adjusting
            reports.send(MapperReport(change, mapper.loops, has_request, settled))
    except (EOFError, BrokenPipeError):
        pass  # the tracker has ended
    finally:
        mapper.close()


def _serve(mapper: Mapper, request: Request) -> None:
    match request:
        case KeyframeRequest():
            mapper.insert(request)
        case FeatureVerdicts():
            mapper.retract(request)
        case Settle(limit_s):
            mapper.finish_adjustment(limit_s)
        case Resume(whole, loops):
            mapper.resume(whole, loops)
        case Load(state, first_uid, keep):
            mapper.load(state, first_uid, keep=keep)
        case Start():
            mapper.start_map(*request)
