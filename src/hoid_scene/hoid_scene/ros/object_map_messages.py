"""Converts the object map to messages: the objects at rest as detections, and markers."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point
from hoid_msgs.msg import MappedObject
from std_msgs.msg import ColorRGBA, Header
from vision_msgs.msg import (
    BoundingBox3D,
    Detection3D,
    Detection3DArray,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
)
from visualization_msgs.msg import MarkerArray

from hoid_common.ros import conversions
from hoid_common.values import ObjectState
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.ros.markers import LabeledBox, markers_of, vector_to_msg

_COLORS = {
    ObjectState.AT_REST: ColorRGBA(r=0.3, g=0.7, b=0.3, a=0.4),
    ObjectState.MOVED: ColorRGBA(r=0.2, g=0.6, b=1.0, a=0.5),
    ObjectState.HANDLED: ColorRGBA(r=1.0, g=0.6, b=0.1, a=0.3),
    ObjectState.GONE: ColorRGBA(r=0.5, g=0.5, b=0.5, a=0.15),
}


def object_map_to_msg(objects: tuple[MapObject, ...], header: Header) -> Detection3DArray:
    """Return the objects at rest, those that were moved before included, in the header's frame.

    The stamp of a detection is that of the last sighting. Its hypotheses are the classes that
    were detected, each with the probability that the object is there and is of this class.
    """
    at_rest = [item for item in objects if item.is_present]
    return Detection3DArray(header=header, detections=[_detection(o, header) for o in at_rest])


def object_map_markers_to_msg(objects: tuple[MapObject, ...], header: Header) -> MarkerArray:
    """Return markers that replace all earlier ones: a box and a label per object.

    Objects that are handled or gone have markers too.
    """
    return markers_of([_labeled_box(item) for item in objects], header)


def mapped_object_to_msg(item: MapObject) -> MappedObject:
    """Return the message of one object, in the map frame."""
    x, y, z = np.zeros(3) if item.moved_from_map_m is None else item.moved_from_map_m.tolist()
    return MappedObject(
        id=item.object_id,
        class_name=item.class_name,
        state=item.state.value,
        is_new=item.is_new,
        pose=conversions.pose_to_msg(item.T_map_object),
        size=vector_to_msg(item.size_m),
        probability=item.probability,
        score=item.score,
        views=item.num_views,
        sightings=item.num_sightings,
        first_seen=conversions.stamp_to_msg(item.first_ns),
        last_seen=conversions.stamp_to_msg(item.last_ns),
        person=item.holder_id,
        was_moved=item.moved_from_map_m is not None,
        moved_from=Point(x=float(x), y=float(y), z=float(z)),
        moved_at=conversions.stamp_to_msg(item.moved_ns),
    )


def _labeled_box(item: MapObject) -> LabeledBox:
    text = f'{item.class_name} {item.object_id}'
    if item.is_present and item.is_new:
        text += ': new'
    elif item.state is not ObjectState.AT_REST:
        text += f': {item.state.name.lower()}'
    pose = conversions.pose_to_msg(item.T_map_object)
    return LabeledBox(item.object_id, pose, item.size_m, text, _COLORS[item.state])


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
        bbox=BoundingBox3D(center=pose, size=vector_to_msg(item.size_m)),
        id=str(item.object_id),
    )
