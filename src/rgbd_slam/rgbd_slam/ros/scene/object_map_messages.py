"""Converts the object map to messages: the objects at rest as detections, and markers."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Vector3
from std_msgs.msg import ColorRGBA, Header
from vision_msgs.msg import (
    BoundingBox3D,
    Detection3D,
    Detection3DArray,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
)
from visualization_msgs.msg import Marker, MarkerArray

from hoid_common.ros import conversions
from hoid_common.values import FloatArray
from rgbd_slam.scene.objects.mapped_object import MapObject, PlaceState

_MIN_SIZE_M = 0.02  # chosen: RViz does not draw a flat marker
_LABEL_M = 0.12  # chosen: height of a label, and its distance from the box
_COLORS = {
    PlaceState.AT_REST: ColorRGBA(r=0.3, g=0.7, b=0.3, a=0.4),
    PlaceState.MOVED: ColorRGBA(r=0.2, g=0.6, b=1.0, a=0.5),
    PlaceState.HANDLED: ColorRGBA(r=1.0, g=0.6, b=0.1, a=0.3),
    PlaceState.GONE: ColorRGBA(r=0.5, g=0.5, b=0.5, a=0.15),
}


def object_map_to_msg(objects: tuple[MapObject, ...], header: Header) -> Detection3DArray:
    """Return the objects at rest, in the frame of the header.

    The stamp of a detection is that of the last sighting. Its hypotheses are the classes that
    were detected, with the probability that the object is there and of this class.
    """
    at_rest = [item for item in objects if item.is_present]
    return Detection3DArray(header=header, detections=[_detection(o, header) for o in at_rest])


def object_map_markers_to_msg(objects: tuple[MapObject, ...], header: Header) -> MarkerArray:
    """Return markers that replace all earlier ones: a box and a label per object."""
    markers = [Marker(header=header, action=Marker.DELETEALL)]
    for item in objects:
        box = _marker(item, header, 'objects')
        box.type = Marker.CUBE
        box.scale = _vector(np.maximum(item.size_m, _MIN_SIZE_M))
        label = _marker(item, header, 'labels')
        label.type = Marker.TEXT_VIEW_FACING
        label.pose.position.z += float(item.size_m[2]) / 2 + _LABEL_M
        label.scale.z = _LABEL_M
        label.color.a = 1.0
        label.text = f'{item.class_name} {item.object_id}'
        if item.state is not PlaceState.AT_REST:
            label.text += f': {item.state.name.lower()}'
        markers += [box, label]
    return MarkerArray(markers=markers)


def _detection(item: MapObject, header: Header) -> Detection3D:
    pose = conversions.pose_to_msg(item.T_map_object)
    total = sum(score for _, score in item.class_scores)
    results = []
    for name, score in item.class_scores:
        share = float(np.clip(item.probability * score / total, 0, 1))
        result = ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(class_id=name, score=share))
        result.pose.pose = pose
        results.append(result)
    return Detection3D(
        header=conversions.header_to_msg(item.last_ns, header.frame_id),
        results=results,
        bbox=BoundingBox3D(center=pose, size=_vector(item.size_m)),
        id=str(item.object_id),
    )


def _marker(item: MapObject, header: Header, namespace: str) -> Marker:
    marker = Marker(header=header, ns=namespace, id=item.object_id, action=Marker.ADD)
    marker.pose = conversions.pose_to_msg(item.T_map_object)
    color = _COLORS[item.state]
    marker.color = ColorRGBA(r=color.r, g=color.g, b=color.b, a=color.a)
    return marker


def _vector(values: FloatArray) -> Vector3:
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)
