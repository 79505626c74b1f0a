"""Makes markers of boxes with labels."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import NamedTuple

import numpy as np
from geometry_msgs.msg import Pose, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from hoid_common.values import FloatArray

_MIN_SIZE_M = 0.02  # chosen: RViz does not draw a flat marker
_LABEL_M = 0.12  # chosen: height of a label, and its distance from the box


class LabeledBox(NamedTuple):
    """A box with a label above it."""

    number: int  # identifies the object; the same in all messages
    pose: Pose  # of the center of the box, in the frame of the header
    size_m: FloatArray  # (3,) along the axes of the box
    text: str  # of the label
    color: ColorRGBA  # of the box


def markers_of(boxes: Sequence[LabeledBox], header: Header) -> MarkerArray:
    """Return markers that replace all earlier ones: a cube and a label for each box."""
    markers = [Marker(header=header, action=Marker.DELETEALL)]
    for item in boxes:
        box = _marker(item, header, 'objects')
        box.type = Marker.CUBE
        box.scale = vector_to_msg(np.maximum(item.size_m, _MIN_SIZE_M))
        label = _marker(item, header, 'labels')
        label.type = Marker.TEXT_VIEW_FACING
        label.pose.position.z += float(item.size_m[2]) / 2 + _LABEL_M
        label.scale.z = _LABEL_M
        label.color.a = 1.0
        label.text = item.text
        markers += [box, label]
    return MarkerArray(markers=markers)


def vector_to_msg(values: FloatArray) -> Vector3:
    """Return the message of a vector (3,)."""
    x, y, z = values.tolist()
    return Vector3(x=float(x), y=float(y), z=float(z))


def _marker(item: LabeledBox, header: Header, namespace: str) -> Marker:
    marker = Marker(header=header, ns=namespace, id=item.number, action=Marker.ADD)
    marker.pose, marker.color = deepcopy(item.pose), deepcopy(item.color)
    return marker
