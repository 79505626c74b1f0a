"""Recorder of what the nodes publish during a replay."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from hoid_msgs.msg import DetectionArray, DynamicObjectArray, Features, SlamStatus
from hoid_msgs.srv import SaveTrajectory
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, PointCloud2

from hoid_bringup.live.live_metrics import LiveMetrics
from hoid_bringup.live.node_specs import SLAM
from hoid_common import topics
from hoid_common.errors import InputError
from hoid_common.io.tum_text import read_tum
from hoid_common.ros import conversions, qos
from hoid_common.ros.conversions.slam import slam_status_from_msg
from hoid_common.ros.execution.executor import SteadyExecutor
from hoid_common.slam_status import SlamState
from hoid_common.slam_status import SlamStatus as Status
from hoid_common.values import FloatArray, Trajectory

# Chosen: interval of spinning, because waking for each message would take processor time from the
# nodes.
_PAUSE_S = 0.1
_QUEUE = 200  # chosen: the messages of some seconds, because the recorder may lag behind the nodes
_SERVICE_TIMEOUT_S = 60.0  # chosen: saving a trajectory takes much less
_MAP_TIMEOUT_S = 5.0  # wait for map points; not tuned


class LiveRecorder:
    """Records the results of the nodes and when they arrive; `spin` receives the messages.

    Args:
        node: Node of this process, in the namespace of the other nodes; the recorder spins it.
        camera_info: Topic on which `missing` publishes camera_info.
    """

    def __init__(self, node: Node, camera_info: str = topics.CAMERA_INFO) -> None:
        self.metrics = LiveMetrics()
        self.last_status: Status | None = None
        self._node = node
        self._executor = SteadyExecutor()
        self._executor.add_node(node)
        self._cloud: PointCloud2 | None = None
        self._num_clouds = 0
        self._save = node.create_client(SaveTrajectory, topics.SAVE_TRAJECTORY.replace('~', SLAM))
        self._cameras = node.create_publisher(CameraInfo, camera_info, qos.OUTPUT)
        self._listen(CameraInfo, camera_info, self._on_camera, reliable=False)
        self._listen(Odometry, topics.ODOM, self._on_odometry)
        self._listen(Features, topics.FEATURES, self._on_features)
        self._listen(DetectionArray, topics.DETECTIONS, self._on_detections)
        self._listen(DynamicObjectArray, topics.DYNAMIC_OBJECTS, self._on_objects)
        node.create_subscription(PointCloud2, topics.MAP_POINTS, self._on_cloud, qos.LATCHED)
        # Latched, because the status before the first image is published only once, perhaps before
        # this subscription is discovered.
        node.create_subscription(
            SlamStatus, topics.SLAM_STATUS, self._on_status, qos.profile(_QUEUE, latched=True)
        )

    def _listen(
        self, kind: type[Any], topic: str, callback: Callable[..., None], *, reliable: bool = True
    ) -> None:
        profile = qos.profile(_QUEUE, reliable=reliable)
        self._node.create_subscription(kind, topic, callback, profile)

    def spin(self, timeout_s: float) -> None:
        end_s = time.monotonic() + timeout_s
        while (left_s := end_s - time.monotonic()) > 0:
            if not self._executor.spin_ready():
                time.sleep(min(left_s, _PAUSE_S))

    def missing(self, camera_info: bytes) -> str:
        """Return why the filter or SLAM node cannot receive images yet; '' if both can.

        Once all connections exist, each call also publishes `camera_info`, a serialized message,
        until the SLAM node has published its status. Its mapping process then runs before the
        first image.
        """
        outputs = (topics.FEATURES, topics.ODOM)
        if not all(self._node.count_publishers(topic) for topic in outputs):
            return f'{topics.FEATURES} and {topics.ODOM} have no publisher'
        subscriptions = (
            self._node.count_subscribers(topics.FEATURES),
            self._cameras.get_subscription_count(),
        )
        if min(subscriptions) <= 1:  # one is the recorder's own
            return f'{topics.FEATURES} and {self._cameras.topic_name} have no subscriber'
        if not self._save.service_is_ready():
            return f'the service {self._save.srv_name} is not available'
        if self.last_status is None:
            self._cameras.publish(camera_info)
            return f'{SLAM} does not start after the message on {self._cameras.topic_name}'
        return ''

    def state_text(self) -> str:
        return self.last_status.state.name.lower() if self.last_status is not None else ''

    def trajectory(self, kind: str, folder: Path) -> Trajectory:
        """Let the SLAM node save a trajectory in its map directory `folder`, and return it.

        Args:
            kind: 'final', 'online' or 'keyframes'.
        """
        name = f'{kind}.txt'
        future = self._save.call_async(SaveTrajectory.Request(name=name, kind=kind))
        self._executor.spin_until_future_complete(future, _SERVICE_TIMEOUT_S)
        response = future.result() if future.done() else None
        if response is None:
            raise InputError(
                f'{self._save.srv_name}: no response in {_SERVICE_TIMEOUT_S:g} s; see '
                'the log of the node'
            )
        if not response.success:
            raise InputError(f'{self._save.srv_name}: {response.message}')
        return read_tum(folder / name)

    def latest_map_points_m(self) -> FloatArray:
        """Wait at most 5 s for map points; return the last ones (N, 3) in the map frame."""
        before, end_s = self._num_clouds, time.monotonic() + _MAP_TIMEOUT_S
        while self._num_clouds == before and time.monotonic() < end_s:
            self._executor.spin_once(timeout_sec=0.1)
        if self._cloud is None:
            return np.empty((0, 3))
        return conversions.cloud_from_msg(self._cloud).points_m.astype(np.float64)

    def _on_camera(self, msg: CameraInfo, info: Mapping[str, int]) -> None:
        # The arrival of camera_info counts as the publication of the image, which follows at once:
        # a subscription to images would take far more processor time.
        stamp_ns = conversions.stamp_from_msg(msg.header.stamp)
        self.metrics.published_ns[stamp_ns] = info['source_timestamp']

    def _on_odometry(self, msg: Odometry, info: Mapping[str, int]) -> None:
        stamp_ns = conversions.stamp_from_msg(msg.header.stamp)
        self.metrics.odometry_ns[stamp_ns] = info['received_timestamp']

    def _on_status(self, msg: SlamStatus) -> None:
        stamp_ns = conversions.stamp_from_msg(msg.header.stamp)
        self.last_status = slam_status_from_msg(msg)
        if self.last_status.frames_processed and self.last_status.state is not SlamState.PAUSED:
            self.metrics.processed.add(stamp_ns)
            self.metrics.record_stages(stamp_ns, self.last_status.stage_ms)

    def _on_features(self, msg: Features) -> None:
        counts = conversions.feature_counts_from_msg(msg)
        stamp_ns = conversions.stamp_from_msg(msg.header.stamp)
        self.metrics.num_features[stamp_ns] = counts.num_detected, counts.num_removed
        stages = {'extract': counts.extract_ms, 'filter': counts.filter_ms}
        self.metrics.record_stages(stamp_ns, stages)

    def _on_detections(self, msg: DetectionArray) -> None:
        stamp_ns = conversions.stamp_from_msg(msg.header.stamp)
        self.metrics.record_stages(stamp_ns, {'detect': msg.inference_ms})

    def _on_objects(self, msg: DynamicObjectArray) -> None:
        stamp_ns = conversions.stamp_from_msg(msg.header.stamp)
        self.metrics.num_dynamic[stamp_ns] = sum(item.dynamic for item in msg.objects)

    def _on_cloud(self, msg: PointCloud2) -> None:
        self._cloud = msg
        self._num_clouds += 1
