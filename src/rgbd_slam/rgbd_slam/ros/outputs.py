"""Everything that the node publishes."""

from __future__ import annotations

import numpy as np
from hoid_msgs.msg import SlamStatus
from nav_msgs.msg import Odometry, Path
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from hoid_common import topics
from hoid_common.ros import conversions, qos
from hoid_common.ros.conversions.slam import keyframes_to_msg, slam_status_to_msg
from hoid_common.ros.frame_tree import TransformPublisher
from rgbd_slam.config.node_config import FrameConfig
from rgbd_slam.robot_frames import RobotPose
from rgbd_slam.session import Processed, SlamSession


class SlamOutputs:
    """Publishers of the node; every message carries the stamp of the image it came from."""

    def __init__(self, node: Node, frames: FrameConfig) -> None:
        self.frames = frames
        self._transforms = TransformPublisher(node)
        self._odom = node.create_publisher(Odometry, topics.ODOM, qos.OUTPUT)
        self._status = node.create_publisher(SlamStatus, topics.SLAM_STATUS, qos.OUTPUT)
        self._path = node.create_publisher(Path, topics.PATH, qos.LATCHED)
        self._points = node.create_publisher(PointCloud2, topics.MAP_POINTS, qos.LATCHED)
        self._keyframes = node.create_publisher(MarkerArray, topics.KEYFRAMES, qos.LATCHED)

    def publish(self, done: Processed, header: Header) -> None:
        """Publish what one image gave; the header is that of its features."""
        if done.pose is not None:
            self._publish_pose(done.pose, header)
        self._status.publish(slam_status_to_msg(done.status, header))

    def publish_map(self, session: SlamSession) -> None:
        """Publish path, points and keyframes as the map says now."""
        header = conversions.header_to_msg(session.stamp_ns, self.frames.map)
        path, cloud = session.path(), conversions.Cloud(session.map_points_m().astype(np.float32))
        self._path.publish(conversions.path_to_msg(path.stamps_ns, path.T_world_camera, header))
        self._points.publish(conversions.cloud_to_msg(cloud, header))
        self._keyframes.publish(keyframes_to_msg(session.keyframe_poses(), header))

    def _publish_pose(self, pose: RobotPose, header: Header) -> None:
        names = self.frames
        base = names.base or header.frame_id
        edges = []
        if names.publish_map_to_odom:
            edges.append((names.map, names.odom, pose.T_map_odom))
        if names.publish_odom_to_base:
            edges.append((names.odom, base, pose.T_odom_base))
        odom_header = Header(stamp=header.stamp, frame_id=names.odom)
        self._odom.publish(
            conversions.odometry_to_msg(
                pose.T_odom_base, pose.covariance, pose.twist, odom_header, base
            )
        )
        self._transforms.send(conversions.stamp_from_msg(header.stamp), edges)
