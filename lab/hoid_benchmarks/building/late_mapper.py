"""A mapper in virtual time: its answers reach the tracker a chosen number of images later.

It stands for the mapping process, but time passes only from image to image, so that the load of
the machine changes nothing. Everything that the benchmark needs to know of the interface between
tracker and mapper is in this file.
"""

from __future__ import annotations

import math
import pickle
import time
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from hoid_common.values import NS_PER_S, FeatureVerdicts, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.loops.loop_closing import LoopCounts
from rgbd_slam.mapper import KeyframeRequest, Mapper
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.map_state import MapState
from rgbd_slam.session import SlamSession

_NEVER_S = math.inf
_PROTOCOL = pickle.HIGHEST_PROTOCOL


@dataclass(frozen=True)
class Delay:
    """How late the mapper answers. Answers keep their order."""

    constant_s: float = 0.0  # an answer is never earlier than the image after its request
    stall_s: float = 0.0  # delay of the first request from `stall_at_s` on
    stall_at_s: float = _NEVER_S
    cpu_factor: float = 0.0  # each request also takes its own CPU time, multiplied by this


class Answer(NamedTuple):
    """What one keyframe cost, and when its changes reached the tracker."""

    request_s: float  # stamp of the image at which it was sent
    answer_s: float
    cpu_ms: float  # CPU time of the mapper
    num_bytes: int  # of the change that was sent to the tracker
    num_keyframes: int  # in the map
    is_stalled: bool


class _Pending(NamedTuple):
    answer: Answer
    change: bytes
    loops: LoopCounts


class LateMapper:
    """Implements `MapperClient`: a mapper with a map of its own.

    Args:
        camera: The camera with its configured noise.
        atlas: The tracker's copy of the map.
        config: Parameters of the core.
        delay: How late it answers.
    """

    num_restarts = 0

    def __init__(
        self, camera: StereoCamera, atlas: Atlas, config: SlamConfig, delay: Delay
    ) -> None:
        self._atlas = atlas
        self._own = Atlas(config.camera.scale_factor, config.camera.num_octaves)
        self._mapper = Mapper(camera, self._own, config)
        self._delay = delay
        self._version = 0
        self._now_s = 0.0
        self._last_answer_s = 0.0
        self._has_stalled = False
        self._requests: deque[tuple[float, bytes]] = deque()
        self._pending: deque[_Pending] = deque()
        self.answers: list[Answer] = []  # that have reached the tracker
        self.loops = LoopCounts()

    # ---- virtual time

    def proceed(self, stamp_ns: int) -> None:
        """Proceed to the image with this stamp: handle the requests that were sent before it."""
        self._now_s = stamp_ns / NS_PER_S
        while self._requests:
            self._pending.append(self._handle(*self._requests.popleft()))

    def _handle(self, request_s: float, request: bytes) -> _Pending:
        """Serve a request at once, and determine when the tracker gets the answer."""
        content: KeyframeRequest | FeatureVerdicts = pickle.loads(request)  # noqa: S301  our own
        start_s = time.process_time()
        if isinstance(content, FeatureVerdicts):
            self._mapper.retract(content)
        else:
            self._mapper.insert(content)
        change = self._change()
        cpu_s = time.process_time() - start_s
        is_stalled = not self._has_stalled and request_s >= self._delay.stall_at_s
        self._has_stalled |= is_stalled
        latency_s = self._delay.stall_s if is_stalled else self._delay.constant_s
        answer_s = max(request_s + latency_s, self._last_answer_s)
        answer_s += self._delay.cpu_factor * cpu_s
        self._last_answer_s = answer_s
        return _Pending(
            Answer(
                request_s,
                answer_s,
                1e3 * cpu_s,
                len(change),
                len(self._own.keyframes),
                is_stalled,
            ),
            change,
            self._mapper.loops,
        )

    # ---- MapperClient

    @property
    def queue_length(self) -> int:
        """Return the number of requests whose answers have not reached the tracker."""
        return len(self._requests) + len(self._pending)

    @property
    def is_settled(self) -> bool:
        """Return whether the map will stay as it is until the next request."""
        return self.queue_length == 0

    def start_map(self, frame: Frame, T_map_camera: FloatArray, map_id: int) -> int:
        """Create the first keyframe of a map at once and return its row."""
        self._deliver_all()
        row = self._mapper.start_map(frame, T_map_camera, map_id)
        self._apply(self._change())
        return row

    def insert(self, request: KeyframeRequest) -> int | None:
        """Queue a keyframe."""
        self._send(request)
        return None

    def retract(self, verdicts: FeatureVerdicts) -> None:
        """Queue the removal of the observations of a keyframe's dynamic features."""
        self._send(verdicts)

    def load(self, state: MapState, *, keep: bool) -> int:
        """Load a saved map at once and return the row of its first keyframe."""
        self._deliver_all()
        row = self._mapper.load(state, keep=keep)
        self._apply(self._change())
        return row

    def update(self) -> None:
        """Apply the answers that are due to the tracker's map."""
        while self._pending and self._pending[0].answer.answer_s <= self._now_s:
            answer, change, self.loops = self._pending.popleft()
            self._apply(change)
            self.answers.append(answer)

    def settle(self) -> None:
        """Complete all requests and adjust the whole map."""
        self._deliver_all()
        self._mapper.finish_adjustment(0.0)
        self._apply(self._change())

    def finish(self) -> None:
        """Do the same as `settle`: nothing runs in the background."""
        self.settle()

    def close(self) -> None:
        """Do nothing: there is no process."""

    def _send(self, request: KeyframeRequest | FeatureVerdicts) -> None:
        """Queue a request as bytes, so that tracker and mapper share no memory."""
        self._requests.append((self._now_s, pickle.dumps(request, _PROTOCOL)))

    def _deliver_all(self) -> None:
        now_s = self._now_s
        self.proceed(round(now_s * NS_PER_S))
        self._now_s = _NEVER_S
        self.update()
        self._now_s = now_s

    def _change(self) -> bytes:
        change = self._own.changes_since(self._version)
        self._version = change.version
        return pickle.dumps(change, _PROTOCOL)

    def _apply(self, change: bytes) -> None:
        self._atlas.apply(pickle.loads(change))  # noqa: S301  our own


def with_late_mapper(session: SlamSession, config: SlamConfig, delay: Delay) -> LateMapper:
    """Replace the mapper of a session that has not started yet."""
    camera = StereoCamera.from_model(session.camera, config.camera)
    mapper = LateMapper(camera, session.slam.map.atlas, config, delay)
    session.slam.map.mapper = mapper
    return mapper
