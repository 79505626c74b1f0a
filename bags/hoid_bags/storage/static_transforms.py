"""Constant transforms between frames, as the messages of /tf_static."""

from __future__ import annotations

from hoid_bags.storage.bag_types import TF_MESSAGE, Message, new_message
from hoid_common import se3
from hoid_common.values import FloatArray


def transform(T_parent_child: FloatArray) -> Message:
    """Return the geometry_msgs/Transform of a (4, 4) matrix."""
    x, y, z = T_parent_child[:3, 3].tolist()
    qx, qy, qz, qw = se3.quat_xyzw_from_rotation(T_parent_child[:3, :3]).tolist()
    return new_message(
        'geometry_msgs/msg/Transform',
        translation=new_message('geometry_msgs/msg/Vector3', x=x, y=y, z=z),
        rotation=new_message('geometry_msgs/msg/Quaternion', x=qx, y=qy, z=qz, w=qw),
    )


def static_transforms(*edges: tuple[str, str, FloatArray]) -> Message:
    """Return the tf2_msgs/TFMessage of edges (parent, child, T_parent_child), with stamp 0."""
    stamp = new_message('builtin_interfaces/msg/Time', sec=0, nanosec=0)
    return new_message(
        TF_MESSAGE,
        transforms=[
            new_message(
                'geometry_msgs/msg/TransformStamped',
                header=new_message('std_msgs/msg/Header', stamp=stamp, frame_id=parent),
                child_frame_id=child,
                transform=transform(T_parent_child),
            )
            for parent, child, T_parent_child in edges
        ],
    )
