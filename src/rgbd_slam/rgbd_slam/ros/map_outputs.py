"""Publishing of path, map points and keyframes of the main map, in a separate thread."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from itertools import count
from queue import SimpleQueue
from threading import Event, Thread
from typing import NamedTuple

import numpy as np
from nav_msgs.msg import Path
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from hoid_common import topics
from hoid_common.errors import InputError
from hoid_common.ros import conversions, qos
from hoid_common.ros.execution.timers import set_period
from hoid_common.ros.large_messages.publisher import OnDemandPublisher
from hoid_common.ros.large_messages.serialized import (
    cloud_to_cdr,
    keyframes_to_cdr,
    path_to_cdr,
)
from hoid_common.values import ByteArray, Float32Array
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.mapping.slam_map import MapPoses, SlamMap
from rgbd_slam.ros.node_thread import NodeThread
from rgbd_slam.session import SlamSession

# Chosen: largest ratio of a core for creating and publishing map_points, path and keyframes, so
# that they are sent less often for large maps. Messages for 10,000 keyframes with 1.7 million
# points take 0.1 s, and are therefore sent at most every 2 s.
_MAX_SHARE = 0.05
# Chosen: number of rows of points that are copied at once, which delays an image by less than 2
# ms.
_ROWS = 2**19


class _Snapshot(NamedTuple):
    """The poses of the map at one time, copied in the node's thread."""

    map: SlamMap
    header: Header
    poses: MapPoses


class _Job(NamedTuple):
    snapshot: _Snapshot
    publishers: list[OnDemandPublisher]


class MapOutputs:
    """The latched topics of the map: path, map points and keyframes.

    A message is created only for a topic with subscribers, and only if the map has changed since
    its last message. This is checked every `map_period_s`, or less often if creating messages
    takes long, and whenever a subscriber joins or leaves. The node's thread only copies the map.
    """

    def __init__(
        self, node: Node, config: SlamNodeConfig, session: Callable[[], SlamSession | None]
    ) -> None:
        self._frame, self._session = config.frames.map, session
        self._node_thread, self._context = NodeThread(node), node.context
        self._logger = node.get_logger()
        self._makers: dict[OnDemandPublisher, Callable[[_Snapshot], ByteArray]] = {
            OnDemandPublisher(node, type_, topic, qos.LATCHED, self._publish): make
            for type_, topic, make in (
                (Path, topics.PATH, _path),
                (PointCloud2, topics.MAP_POINTS, self._points),
                (MarkerArray, topics.KEYFRAMES, _keyframes),
            )
        }
        self._outdated: set[OnDemandPublisher] = set()  # topics whose last message is outdated
        self._is_busy, self._rest_until_s = False, 0.0
        self._is_retried = False  # True: creating the last messages has failed and is tried again
        self._is_ended = Event()
        self._jobs: SimpleQueue[_Job | None] = SimpleQueue()
        self._thread = Thread(target=self._run, name='map outputs', daemon=True)
        self._thread.start()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(config.map_period_s, self._on_timer, clock=steady)

    def reconfigure(self, config: SlamNodeConfig) -> None:
        set_period(self._timer, config.map_period_s)

    def close(self) -> None:
        """End the thread after the messages that it is creating, without waiting for it."""
        self._is_ended.set()
        self._jobs.put(None)

    def _on_timer(self) -> None:
        if time.monotonic() >= self._rest_until_s:
            self._publish()

    def _publish(self) -> None:
        """Request messages for all topics that have subscribers and are outdated."""
        session = self._session()
        if session is None or self._is_busy:
            return
        if session.map.consume_change() or self._is_retried:
            self._outdated.update(self._makers)
            self._is_retried = False
        wanted = [publisher for publisher in self._outdated if publisher.is_wanted]
        if wanted:
            self._outdated.difference_update(wanted)
            self._is_busy = True
            self._jobs.put(_Job(self._snapshot(session), wanted))

    def _snapshot(self, session: SlamSession) -> _Snapshot:
        header = conversions.header_to_msg(session.stamp_ns, self._frame)
        return _Snapshot(session.map, header, session.map.copy_poses())

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            start_s, start_cpu_s = time.monotonic(), time.thread_time()
            try:
                for publisher in job.publishers:
                    publisher.publish(self._makers[publisher](job.snapshot))
            except InputError as error:  # the next timer tries again
                self._logger.warning(f'path, map points and keyframes are not published: {error}')
                self._is_retried = True
            except (InvalidHandle, RuntimeError):  # rclpy's errors after the end of the node
                if self._context.ok() and not self._is_ended.is_set():
                    raise
                return
            self._rest_until_s = start_s + (time.thread_time() - start_cpu_s) / _MAX_SHARE
            self._is_busy = False

    def _points(self, snapshot: _Snapshot) -> ByteArray:
        """Return the serialized cloud of the main map's points, which are copied part by part."""
        slam_map, map_id = snapshot.map, snapshot.poses.map_id
        points_m: list[Float32Array] = []
        for first in count(0, _ROWS):
            copy = partial(slam_map.copy_points, map_id, first, _ROWS)
            rows = self._node_thread.call(copy)
            points_m.append(slam_map.shown_points_m(rows))
            if rows.is_last:
                break
        return cloud_to_cdr(conversions.Cloud(np.concatenate(points_m)), snapshot.header)


def _path(snapshot: _Snapshot) -> ByteArray:
    path = snapshot.map.path_of(snapshot.poses)
    return path_to_cdr(path.stamps_ns, path.T_world_camera, snapshot.header)


def _keyframes(snapshot: _Snapshot) -> ByteArray:
    return keyframes_to_cdr(snapshot.map.cameras_of(snapshot.poses), snapshot.header)
