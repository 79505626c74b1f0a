"""Conversion of detections: hoid_msgs/DetectionArray."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hoid_msgs.msg import Detection, DetectionArray
from std_msgs.msg import Header

from hoid_common.errors import MessageError
from hoid_common.ros.conversions.headers import stamp_from_msg
from hoid_common.values import Detections

MAX_DETECTIONS = 1000
"""Largest number of boxes in a message. Chosen: COCO's evaluation uses 100."""


def detections_from_msg(msg: DetectionArray) -> Detections:
    """Return the boxes, class names and scores of a DetectionArray message.

    Raises:
        MessageError: There are more than MAX_DETECTIONS, or a class name is too long.
    """
    boxes = msg.detections
    if len(boxes) > MAX_DETECTIONS:
        raise MessageError(f'detections has {len(boxes)} elements, more than {MAX_DETECTIONS}')
    xyxy = [(box.x_min, box.y_min, box.x_max, box.y_max) for box in boxes]
    return Detections(
        stamp_from_msg(msg.header.stamp),
        np.array(xyxy, np.float32).reshape(-1, 4),
        tuple(box.class_name for box in boxes),
        np.array([box.score for box in boxes], np.float32),
    )


def detections_to_msg(
    detections: Detections,
    header: Header,
    image_size_px: tuple[int, int],
    class_names: Sequence[str] = (),
    inference_ms: float = 0.0,
) -> DetectionArray:
    """Return the DetectionArray of an image of this size.

    `class_id` is the index of the class in `class_names`, else -1; `inference_ms` is 0 when no
    network ran.
    """
    ids = {name: i for i, name in enumerate(class_names)}
    return DetectionArray(
        header=header,
        image_width=image_size_px[0],
        image_height=image_size_px[1],
        inference_ms=inference_ms,
        detections=[
            Detection(
                class_name=name,
                class_id=ids.get(name, -1),
                score=score,
                x_min=box[0],
                y_min=box[1],
                x_max=box[2],
                y_max=box[3],
            )
            for name, score, box in zip(
                detections.class_names,
                detections.scores.tolist(),
                detections.boxes_xyxy_px.tolist(),
                strict=True,
            )
        ],
    )
