"""Constant transforms between frames, as the messages of /tf_static."""

from __future__ import annotations

from hoid_bags.storage.bag_types import TF_MESSAGE, Message, new_message
from hoid_common import se3
from hoid_common.values import FloatArray


def vector(kind: str, values: FloatArray) -> Message:
    """Return the Point, Vector3 or Quaternion of geometry_msgs with values (3,) or (4,)."""
    fields = dict(zip('xyzw', values.tolist(), strict=False))
    return new_message(f'geometry_msgs/msg/{kind}', **fields)


def transform(T_parent_child: FloatArray) -> Message:
    return new_message(
        'geometry_msgs/msg/Transform',
        translation=vector('Vector3', T_parent_child[:3, 3]),
        rotation=vector('Quaternion', se3.quat_xyzw_from_rotation(T_parent_child[:3, :3])),
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
