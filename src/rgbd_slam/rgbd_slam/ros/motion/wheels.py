"""External odometry on /tf, such as that of wheels."""

from __future__ import annotations

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node

from hoid_common import se3, topics
from hoid_common.poses.frames import PoseBuffer, StaticFrames, check_frame_limit
from hoid_common.ros import qos
from hoid_common.ros.conversions import stamp_from_msg, transform_from_msg
from hoid_common.ros.diagnostics import Diagnostics
from hoid_common.ros.frame_tree import listen_to_transforms
from hoid_common.values import FloatArray

# Chosen, to limit the memory: further children of the odometry frame are refused. A robot has one;
# each has a buffer with ten seconds of poses.
_MAX_CHILDREN = 16


class WheelOdometry:
    """Buffers the transforms from the odometry frame to its children, of which a robot has one."""

    def __init__(
        self, node: Node, odom: str, static: StaticFrames, diagnostics: Diagnostics
    ) -> None:
        self._odom = odom
        self._static = static
        self._poses: dict[str, PoseBuffer] = {}  # T_odom_child by child frame
        listen_to_transforms(node, topics.TF, qos.TF, 'transforms', self._add, diagnostics)

    def at(self, stamp_ns: int, base: str) -> FloatArray | None:
        """Return T_odom_base (4, 4) at a stamp; None if no child of `odom` leads to the base."""
        for child, poses in self._poses.items():
            T_child_base = self._static.find(child, base)
            T_odom_child = poses.at(stamp_ns)
            if T_child_base is not None and T_odom_child is not None:
                return T_odom_child @ T_child_base
        return None

    def motion(self, first_ns: int, second_ns: int, base: str) -> FloatArray | None:
        """Return the motion T_first_second (4, 4) of the base between stamps; None if unknown."""
        T_odom_first, T_odom_second = (self.at(ns, base) for ns in (first_ns, second_ns))
        if T_odom_first is None or T_odom_second is None:
            return None
        return se3.inverse(T_odom_first) @ T_odom_second

    def _add(self, edge: TransformStamped) -> None:
        if edge.header.frame_id == self._odom:
            T_odom_child = transform_from_msg(edge)
            poses = self._poses_of(edge.child_frame_id)
            poses.add(stamp_from_msg(edge.header.stamp), T_odom_child)

    def _poses_of(self, child: str) -> PoseBuffer:
        if child not in self._poses:
            check_frame_limit(f'children of {self._odom}', child, len(self._poses), _MAX_CHILDREN)
            self._poses[child] = PoseBuffer()
        return self._poses[child]
