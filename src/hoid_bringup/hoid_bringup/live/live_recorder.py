"""What a replay hears from the nodes, and what it asks of them."""

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
from hoid_common.inputs.input_config import BEST_EFFORT, RELIABLE
from hoid_common.io.trajectory_io import read_tum
from hoid_common.ros import conversions, qos
from hoid_common.ros.conversions.slam import slam_status_from_msg
from hoid_common.ros.execution.executor import SteadyExecutor
from hoid_common.slam_status import SlamState
from hoid_common.slam_status import SlamStatus as Status
from hoid_common.values import FloatArray, Trajectory

_PAUSE_S = 0.1  # not woken by each message: on one core that is the nodes' time
_QUEUE = 200  # the recorder may fall behind the nodes for a while
_ANSWER_LIMIT_S = 60.0
_MAP_LIMIT_S = 5.0


class LiveRecorder:
    """Subscribes to the nodes' results and keeps the numbers; `spin` lets it hear.

    Args:
        node: Of this process, in the nodes' namespace.
        camera_info: Topic of the camera infos.
    """

    def __init__(self, node: Node, camera_info: str = topics.CAMERA_INFO) -> None:
        self.metrics = LiveMetrics()
        self.last_status: Status | None = None
        self.last_stamp_ns = 0
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
        # What it says before its first image is said once, maybe before it knows of this node.
        node.create_subscription(
            SlamStatus, topics.SLAM_STATUS, self._on_status, qos.latched(_QUEUE)
        )

    def _listen(
        self, kind: type[Any], topic: str, callback: Callable[..., None], *, reliable: bool = True
    ) -> None:
        profile = qos.input_qos(RELIABLE if reliable else BEST_EFFORT, _QUEUE)
        self._node.create_subscription(kind, topic, callback, profile)

    def spin(self, timeout_s: float) -> None:
        """Hear what comes within some time."""
        end_s = time.monotonic() + timeout_s
        while (left_s := end_s - time.monotonic()) > 0:
            if not self._executor.spin_ready():
                time.sleep(min(left_s, _PAUSE_S))

    def awaited(self, camera_info: bytes) -> str:
        """Return what the nodes still lack to take images, or nothing when they can.

        The SLAM node is told of the camera, with a serialised message: it then starts its mapping
        process, for which the first images need not wait.
        """
        count_publishers, heard_by = self._node.count_publishers, self._node.count_subscribers
        if not count_publishers(topics.FEATURES) or not count_publishers(topics.ODOM):
            return f'nobody publishes {topics.FEATURES} and {topics.ODOM}'
        if heard_by(topics.FEATURES) <= 1 or self._cameras.get_subscription_count() <= 1:
            return f'nobody else listens to {topics.FEATURES} and {self._cameras.topic_name}'
        if not self._save.service_is_ready():
            return f'nobody offers {self._save.srv_name}'
        if self.last_status is None:
            self._cameras.publish(camera_info)
            return f'{SLAM} does not begin with the camera of {self._cameras.topic_name}'
        return ''

    def state_text(self) -> str:
        """Return the state of the SLAM node in a word."""
        return self.last_status.state.name.lower() if self.last_status is not None else ''

    def trajectory(self, kind: str, folder: Path) -> Trajectory:
        """Have the SLAM node write a trajectory into its folder and read it.

        Raises:
            InputError: It does not answer, or says why it cannot.
        """
        name = f'{kind}.txt'
        future = self._save.call_async(SaveTrajectory.Request(name=name, kind=kind))
        self._executor.spin_until_future_complete(future, _ANSWER_LIMIT_S)
        answer = future.result() if future.done() else None
        if answer is None:
            raise InputError(f'rgbd_slam: no answer to save_trajectory in {_ANSWER_LIMIT_S:g} s')
        if not answer.success:
            raise InputError(f'rgbd_slam: {answer.message}')
        return read_tum(folder / name)

    def latest_map_points_m(self) -> FloatArray:
        """Return (N, 3) points of the next map to be published, or else of the last one."""
        before, end_s = self._num_clouds, time.monotonic() + _MAP_LIMIT_S
        while self._num_clouds == before and time.monotonic() < end_s:
            self._executor.spin_once(timeout_sec=0.1)
        if self._cloud is None:
            return np.empty((0, 3))
        return conversions.cloud_from_msg(self._cloud).points_m.astype(np.float64)

    def _on_camera(self, msg: CameraInfo, info: Mapping[str, int]) -> None:
        # Published just before its image, and much lighter to listen to.
        stamp_ns = conversions.stamp_from_msg(msg.header.stamp)
        self.metrics.note_sent(stamp_ns, info['source_timestamp'])

    def _on_odometry(self, msg: Odometry, info: Mapping[str, int]) -> None:
        stamp_ns = conversions.stamp_from_msg(msg.header.stamp)
        self.metrics.note_odometry(stamp_ns, info['received_timestamp'])

    def _on_status(self, msg: SlamStatus) -> None:
        self.last_stamp_ns = conversions.stamp_from_msg(msg.header.stamp)
        self.last_status = slam_status_from_msg(msg)
        if self.last_status.frames_processed and self.last_status.state is not SlamState.PAUSED:
            self.metrics.note_processed(self.last_stamp_ns)
            self.metrics.note_stages(self.last_stamp_ns, self.last_status.stage_ms)

    def _on_features(self, msg: Features) -> None:
        counts = conversions.feature_counts_from_msg(msg)
        stamp_ns = conversions.stamp_from_msg(msg.header.stamp)
        self.metrics.note_features(stamp_ns, counts.num_detected, counts.num_removed)
        stages = {'extract': counts.extract_ms, 'filter': counts.filter_ms}
        self.metrics.note_stages(stamp_ns, stages)

    def _on_detections(self, msg: DetectionArray) -> None:
        stamp_ns = conversions.stamp_from_msg(msg.header.stamp)
        self.metrics.note_stages(stamp_ns, {'detect': msg.inference_ms})

    def _on_objects(self, msg: DynamicObjectArray) -> None:
        stamp_ns = conversions.stamp_from_msg(msg.header.stamp)
        self.metrics.note_objects(stamp_ns, sum(item.dynamic for item in msg.objects))

    def _on_cloud(self, msg: PointCloud2) -> None:
        self._cloud = msg
        self._num_clouds += 1
