"""The process that maps: it takes keyframes and sends back the rows of the map that changed.

It ends when the pipe from the tracker does, so that it outlives neither `close` nor a killed
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

_NICE = 5  # below tracking, which does not wait for it
_IDLE_S = 0.2  # between looks for results of the background


class Start(NamedTuple):
    """Asks for the first keyframe of a map."""

    frame: Frame
    T_map_camera: FloatArray  # (4, 4)
    map_id: int


class Resume(NamedTuple):
    """Asks to go on with the map that a process before this one has left."""

    whole: MapChange
    loops: LoopCounts


class Settle(NamedTuple):
    """Asks to wait for what runs in the background."""

    limit_s: float


class Load(NamedTuple):
    """Asks to lay a saved map over the running one."""

    state: MapState
    keep: bool  # the running one, beside it


Request = Start | Load | Resume | Settle | KeyframeRequest | FeatureVerdicts


class Ready(NamedTuple):
    """Says that requests are taken from now on."""


class MapperReport(NamedTuple):
    """What the mapper sends after each request, and after changes of its own."""

    change: MapChange
    row: int | None  # of the keyframe that a request made first
    loops: LoopCounts
    is_answer: bool
    is_settled: bool  # whether nothing runs in the background


def run_mapper(
    requests: Connection, reports: Connection, camera: StereoCamera, config: SlamConfig
) -> None:
    """Take keyframes in until the pipe ends; the main function of the process."""
    os.nice(_NICE)
    atlas = Atlas(config.camera.scale_factor, config.camera.num_octaves)
    mapper = Mapper(camera, atlas, config, background=True)
    version = 0
    reports.send(Ready())
    try:
        while True:
            is_answer, row = requests.poll(_IDLE_S), None
            if is_answer:
                row = _do(mapper, requests.recv())
            elif not mapper.poll():
                continue
            change = atlas.changes_since(version)
            version = change.version
            settled = not mapper.is_adjusting
            reports.send(MapperReport(change, row, mapper.loops, is_answer, settled))
    except (EOFError, BrokenPipeError):
        pass  # the tracker has ended
    finally:
        mapper.close()


def _do(mapper: Mapper, request: Request) -> int | None:
    match request:
        case KeyframeRequest():
            return mapper.insert(request)
        case FeatureVerdicts():
            mapper.take_back(request)
        case Settle(limit_s):
            mapper.settle(limit_s)
        case Resume(whole, loops):
            mapper.resume(whole, loops)
        case Load(state, keep):
            return mapper.load(state, keep=keep)
        case Start(frame, T_map_camera, map_id):
            return mapper.start_map(frame, T_map_camera, map_id)
    return None
