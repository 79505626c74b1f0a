"""Conversion of detections: vision_msgs/Detection2DArray, the message of other detectors."""

from __future__ import annotations

import math

import numpy as np
from std_msgs.msg import Header
from vision_msgs.msg import (
    BoundingBox2D,
    Detection2D,
    Detection2DArray,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
)

from hoid_common.errors import MessageError
from hoid_common.messages import MAX_DETECTIONS, stamp_from_msg
from hoid_common.values import Detections

Row = tuple[float, float, float, float]


def detections_2d_from_msg(msg: Detection2DArray) -> Detections:
    """Return the boxes of a Detection2DArray message, each with its class of highest score.

    The `class_id` becomes the name; rotated boxes become the upright boxes around them; values
    that are not finite stay so. MessageError for more than MAX_DETECTIONS, a box without a class,
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
