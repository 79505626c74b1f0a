"""Conversion of detections (of this suite, and vision_msgs) and of dynamic objects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from hoid_msgs.msg import Detection, DetectionArray, DynamicObjectArray
from hoid_msgs.msg import DynamicObject as DynamicObjectMsg
from std_msgs.msg import Header
from vision_msgs.msg import (
    BoundingBox2D,
    Detection2D,
    Detection2DArray,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
)

from hoid_common.errors import MessageError
from hoid_common.messages import MAX_DETECTIONS, detection_fields, stamp_from_msg
from hoid_common.values import MAX_NAME_LENGTH, Detections, DynamicObject, ObjectState

Row = tuple[float, float, float, float]
# Fields that have the same name in DynamicObject and in its message.
_COPIED = ('class_name', 'score', 'track_id', 'overlap_ratio', 'depth_gap_m')
_VECTORS = ('center_camera_m', 'size_m', 'velocity_camera_mps')
# The states that an object in an image can have; the others are for tracks and the object map.
_STATES = frozenset(
    state.value
    for state in set(ObjectState) - {ObjectState.MOVED, ObjectState.GONE, ObjectState.TENTATIVE}
)
_MAX_COORDINATE_PX = 1e5  # chosen far beyond any image size


def detections_to_msg(
    detections: Detections,
    header: Header,
    image_size_px: tuple[int, int],
    class_names: Sequence[str] = (),
    inference_ms: float = 0.0,
) -> DetectionArray:
    """Return the DetectionArray; `class_id` is an index of `class_names`, or -1."""
    return DetectionArray(
        header=header,
        image_width=image_size_px[0],
        image_height=image_size_px[1],
        inference_ms=inference_ms,
        detections=[Detection(**row) for row in detection_fields(detections, class_names)],
    )


def detections_2d_from_msg(msg: Detection2DArray) -> Detections:
    """Return the boxes of a Detection2DArray message, each with its class of highest score.

    The `class_id` becomes the name. Rotated boxes become the upright boxes around them. Non-finite
    values are kept. MessageError for more than MAX_DETECTIONS, a box without a class,
    or a long class name.
    """
    found = msg.detections
    if len(found) > MAX_DETECTIONS:
        raise MessageError(f'detections_2d has {len(found)} elements, more than {MAX_DETECTIONS}')
    best = [_likeliest(detection) for detection in found]
    with np.errstate(over='ignore'):
        boxes_xyxy_px = np.array([_box_from_msg(each.bbox) for each in found], np.float32)
        scores = np.array([hypothesis.score for hypothesis in best], np.float32)
    return Detections(
        stamp_from_msg(msg.header.stamp),
        boxes_xyxy_px.reshape(-1, 4),
        tuple(hypothesis.class_id for hypothesis in best),
        scores,
    )


def detections_2d_to_msg(detections: Detections, header: Header) -> Detection2DArray:
    rows = zip(
        detections.boxes_xyxy_px.tolist(),
        detections.class_names,
        detections.scores.tolist(),
        strict=True,
    )
    return Detection2DArray(
        header=header, detections=[_to_msg(box, name, score, header) for box, name, score in rows]
    )


def _likeliest(detection: Detection2D) -> ObjectHypothesis:
    if not detection.results:
        raise MessageError('detections_2d.results is empty: a box needs a class and a score')
    return max((r.hypothesis for r in detection.results), key=lambda h: h.score)


def _box_from_msg(box: BoundingBox2D) -> Row:
    """Return the upright box (px) around a rotated box; NaN if the angle is not finite."""
    x, y = box.center.position.x, box.center.position.y
    theta_rad = box.center.theta if math.isfinite(box.center.theta) else math.nan
    cos, sin = abs(math.cos(theta_rad)), abs(math.sin(theta_rad))
    half_x = (cos * box.size_x + sin * box.size_y) / 2
    half_y = (sin * box.size_x + cos * box.size_y) / 2
    return x - half_x, y - half_y, x + half_x, y + half_y


def _to_msg(box_xyxy_px: Row, name: str, score: float, header: Header) -> Detection2D:
    left, top, right, bottom = box_xyxy_px
    result = ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(class_id=name, score=score))
    msg = Detection2D(header=header, results=[result])
    msg.bbox.center.position.x, msg.bbox.center.position.y = (left + right) / 2, (top + bottom) / 2
    msg.bbox.size_x, msg.bbox.size_y = right - left, bottom - top
    return msg


def dynamic_objects_from_msg(msg: DynamicObjectArray) -> tuple[DynamicObject, ...]:
    """Return the objects of a message; MessageError for too many, or for values out of range."""
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
    """Return the DynamicObjectArray of an image; a final message follows a `provisional` one."""
    return DynamicObjectArray(
        header=header,
        image_width=image_size_px[0],
        image_height=image_size_px[1],
        objects=[_object_to_msg(obj) for obj in objects],
        provisional=provisional,
    )


def _object_from_msg(msg: DynamicObjectMsg) -> DynamicObject:
    if msg.state not in _STATES:
        raise MessageError(
            f'dynamic_objects.state is {msg.state}, no state of an object in an image; see '
            'hoid_msgs/ObjectState'
        )
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
    copied: dict[str, Any] = {name: getattr(msg, name) for name in _COPIED}
    copied |= {name: tuple(getattr(msg, name).tolist()) for name in _VECTORS}
    return DynamicObject(box_xyxy_px=box_xyxy_px, state=ObjectState(msg.state), **copied)


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
        **{name: [float(value) for value in getattr(obj, name)] for name in _VECTORS},
    )
