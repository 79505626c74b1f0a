"""Publishing of odometry, transforms and status of the SLAM node, after each image."""

from __future__ import annotations

from hoid_msgs.msg import SlamStatus as SlamStatusMsg
from nav_msgs.msg import Odometry
from rclpy.node import Node
from std_msgs.msg import Header

from hoid_common import se3, topics
from hoid_common.poses.frames import StaticFrames
from hoid_common.ros import conversions, qos
from hoid_common.ros.conversions.slam import slam_status_to_msg
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.frame_tree import TransformPublisher
from hoid_common.slam_status import SlamStatus
from hoid_common.values import NS_PER_S, FloatArray
from rgbd_slam.config.node_config import FrameConfig
from rgbd_slam.robot_frames import RobotPose
from rgbd_slam.ros.motion.wheels import WheelOdometry

_WHEELS = 'wheels'


def visual_frame(odom: str) -> str:
    """Return `odom` with "visual_" before the part that follows the last slash."""
    prefix, slash, name = odom.rpartition('/')
    return f'{prefix}{slash}visual_{name}'


class SlamOutputs:
    """Publishers of odometry, transforms and status.

    Messages have the stamp of the header that a method gets. Only the stamp of map -> odom is
    later, by `transform_tolerance_s`, if another node sends odom -> base.

    Args:
        wheels: Odometry of the other node that sends odom -> base; None: this node sends it.
    """

    def __init__(
        self,
        node: Node,
        frames: FrameConfig,
        static: StaticFrames,
        wheels: WheelOdometry | None,
        diagnostics: Diagnostics,
    ) -> None:
        self._node, self._static, self._diagnostics = node, static, diagnostics
        self._wheels = wheels
        self._T_map_wheels: FloatArray | None = None
        self.frames = frames
        self._transforms = TransformPublisher(node)
        own, self._odom_frame = topics.ODOM, frames.odom
        if wheels is not None:
            # The odometry of the other node (wheels) defines the frame `odom`. Visual odometry
            # drifts relative to it, and therefore has a frame with another name.
            own, self._odom_frame = topics.VISUAL_ODOM, visual_frame(frames.odom)
        self._odom = node.create_publisher(Odometry, own, qos.OUTPUT)
        self._status = node.create_publisher(SlamStatusMsg, topics.SLAM_STATUS, qos.STATE)

    def reconfigure(self, frames: FrameConfig) -> None:
        self.frames = frames

    def publish_pose(self, pose: RobotPose | None, header: Header) -> None:
        """Publish the odometry of an image, and the transforms that the parameters request."""
        if pose is not None:
            self._publish_odometry(pose, header)
        self._publish_tree(pose, header)

    def publish_status(self, status: SlamStatus, header: Header) -> None:
        self._status.publish(slam_status_to_msg(status, header))

    def find_in_map(self, frame: str) -> FloatArray | None:
        """Return T_map_frame (4, 4) from /tf_static and the transforms that this node sent."""
        return self._static.with_edges(self._transforms.sent).find(self.frames.map, frame)

    def _publish_odometry(self, pose: RobotPose, header: Header) -> None:
        self._odom.publish(
            conversions.odometry_to_msg(
                pose.T_odom_base,
                pose.covariance,
                pose.twist,
                pose.twist_covariance,
                Header(stamp=header.stamp, frame_id=self._odom_frame),
                self._base(header),
            )
        )

    def _publish_tree(self, pose: RobotPose | None, header: Header) -> None:
        names, stamp_ns = self.frames, conversions.stamp_from_msg(header.stamp)
        edges = []
        if self._wheels is not None:
            T_wheels_base = self._wheels.at(stamp_ns, self._base(header))
            T_map_odom = self._map_to_wheels(pose, T_wheels_base, self._base(header))
            stamp_ns += int(names.transform_tolerance_s * NS_PER_S)
        else:
            T_map_odom = None if pose is None else pose.T_map_odom
            if pose is not None:
                edges.append((names.odom, self._base(header), pose.T_odom_base))
        if T_map_odom is not None and names.publish_map_to_odom:
            edges.insert(0, (names.map, names.odom, T_map_odom))
        if edges:
            self._transforms.send(stamp_ns, edges)

    def _map_to_wheels(
        self, pose: RobotPose | None, T_wheels_base: FloatArray | None, base: str
    ) -> FloatArray | None:
        """Return T_map_odom (4, 4) for the odometry frame of the wheels; None if it is unknown.

        While the camera is lost (`pose` is None), it is the latest transform, so that the pose of
        the robot follows the wheels. So it is if the wheels have no pose for the image, which is
        reported as a problem.
        """
        if T_wheels_base is None:
            self._diagnostics.set_problem(
                _WHEELS,
                f'{self._node.resolve_topic_name(topics.TF)} has no transform of the wheels from '
                f'{self.frames.odom} to {base}',
            )
            return self._T_map_wheels
        self._diagnostics.clear_problem(_WHEELS)
        if pose is not None:
            T_map_base = pose.T_map_odom @ pose.T_odom_base
            self._T_map_wheels = T_map_base @ se3.inverse(T_wheels_base)
        return self._T_map_wheels

    def _base(self, header: Header) -> str:
        return self.frames.base or str(header.frame_id)
