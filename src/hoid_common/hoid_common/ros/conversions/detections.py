"""Conversion of detections: hoid_msgs/DetectionArray."""

from __future__ import annotations

from collections.abc import Sequence

from hoid_msgs.msg import Detection, DetectionArray
from std_msgs.msg import Header

from hoid_common.values import Detections


def detections_to_msg(
    detections: Detections,
    header: Header,
    image_size_px: tuple[int, int],
    class_names: Sequence[str] = (),
    inference_ms: float = 0.0,
) -> DetectionArray:
    """Return the DetectionArray; `class_id` is an index of `class_names`, or -1."""
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
