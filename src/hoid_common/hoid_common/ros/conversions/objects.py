"""Conversion of the filter's verdicts on objects: hoid_msgs/DynamicObjectArray."""

from __future__ import annotations

from hoid_msgs.msg import DynamicObject as DynamicObjectMsg
from hoid_msgs.msg import DynamicObjectArray
from std_msgs.msg import Header

from hoid_common.errors import MessageError
from hoid_common.messages import MAX_DETECTIONS
from hoid_common.values import MAX_NAME_LENGTH, DynamicObject, ObjectState

_MAX_COORDINATE_PX = 1e5  # chosen far beyond any image size


def dynamic_objects_from_msg(msg: DynamicObjectArray) -> tuple[DynamicObject, ...]:
    """Return the objects of a message; MessageError for too many, or values out of range."""
    if len(msg.objects) > MAX_DETECTIONS:
        raise MessageError(
            f'dynamic_objects has {len(msg.objects)} elements, more than {MAX_DETECTIONS}'
        )
    return tuple(_object_from_msg(obj) for obj in msg.objects)


def dynamic_objects_to_msg(
    objects: tuple[DynamicObject, ...],
    header: Header,
    image_size_px: tuple[int, int],
    *,
    provisional: bool = False,
) -> DynamicObjectArray:
    """Return the DynamicObjectArray of an image; a final one follows a `provisional` one."""
    return DynamicObjectArray(
        header=header,
        image_width=image_size_px[0],
        image_height=image_size_px[1],
        objects=[_object_to_msg(obj) for obj in objects],
        provisional=provisional,
    )


def _object_from_msg(msg: DynamicObjectMsg) -> DynamicObject:
    if msg.state not in {state.value for state in ObjectState}:
        raise MessageError(f'dynamic_objects.state is {msg.state}; see hoid_msgs/ObjectState')
    if len(msg.class_name) > MAX_NAME_LENGTH:
        raise MessageError(
            f'dynamic_objects: a class name has {len(msg.class_name)} characters, '
            f'more than {MAX_NAME_LENGTH}'
        )
    box_xyxy_px = (msg.x_min, msg.y_min, msg.x_max, msg.y_max)
    is_box = all(abs(edge) <= _MAX_COORDINATE_PX for edge in box_xyxy_px)  # False for NaN
    if not is_box or not 0 <= msg.score <= 1:
        raise MessageError(
            f'dynamic_objects: box {box_xyxy_px} px or score {msg.score} is out of range'
        )
    x, y, z = (float(value) for value in msg.center_camera_m)
    width, height = (float(value) for value in msg.size_m)
    vx, vy, vz = (float(value) for value in msg.velocity_camera_mps)
    return DynamicObject(
        msg.class_name,
        box_xyxy_px,
        msg.score,
        msg.track_id,
        ObjectState(msg.state),
        msg.overlap_ratio,
        msg.depth_gap_m,
        (x, y, z),
        (width, height),
        (vx, vy, vz),
    )


def _object_to_msg(obj: DynamicObject) -> DynamicObjectMsg:
    x_min, y_min, x_max, y_max = (float(value) for value in obj.box_xyxy_px)
    return DynamicObjectMsg(
        class_name=obj.class_name,
        score=float(obj.score),
        track_id=obj.track_id,
        dynamic=obj.is_dynamic,
        state=obj.state.value,
        x_min=x_min,
        y_min=y_min,
        x_max=x_max,
        y_max=y_max,
        overlap_ratio=float(obj.overlap_ratio),
        depth_gap_m=float(obj.depth_gap_m),
        center_camera_m=[float(value) for value in obj.center_camera_m],
        size_m=[float(value) for value in obj.size_m],
        velocity_camera_mps=[float(value) for value in obj.velocity_camera_mps],
    )
