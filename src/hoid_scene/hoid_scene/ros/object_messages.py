"""Converts people and objects to messages: tracks, the object map, and markers of both."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import Pose
from hoid_msgs.msg import MappedObject, TrackedObjectArray
from hoid_msgs.msg import ObjectEvent as ObjectEventMsg
from hoid_msgs.msg import TrackedObject as TrackedObjectMsg
from people_msgs.msg import People, Person
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
from hoid_common.ros.conversions.geometry import point_to_msg, vector_to_msg
from hoid_common.values import FloatArray, ObjectState
from hoid_scene.memory.history import ObjectEvent
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.search.object_list import Whereabouts
from hoid_scene.tracks.object_track import TrackedObject

_MIN_SIZE_M = 0.02  # chosen: RViz does not draw a flat marker
_LABEL_M = 0.12  # chosen: height of a label, and its distance from the box
_COLORS = {
    ObjectState.PERSON: ColorRGBA(r=0.9, g=0.2, b=0.2, a=0.5),
    ObjectState.HANDLED: ColorRGBA(r=1.0, g=0.6, b=0.1, a=0.5),
    ObjectState.AT_REST: ColorRGBA(r=0.3, g=0.7, b=0.3, a=0.4),
    ObjectState.MOVED: ColorRGBA(r=0.2, g=0.6, b=1.0, a=0.5),
    ObjectState.MOVING: ColorRGBA(r=0.9, g=0.9, b=0.0, a=0.5),
    ObjectState.GONE: ColorRGBA(r=0.5, g=0.5, b=0.5, a=0.15),
}


class _LabeledBox(NamedTuple):
    """A box with a label above it."""

    number: int  # identifies the object; the same in all messages
    class_name: str
    state: ObjectState
    pose: Pose  # of the center of the box, in the frame of the header
    size_m: FloatArray  # (3,) along the axes of the box
    is_new: bool = False


def tracked_objects_to_msg(
    objects: tuple[TrackedObject, ...], header: Header
) -> TrackedObjectArray:
    return TrackedObjectArray(header=header, objects=[_track_to_msg(item) for item in objects])


def people_to_msg(objects: tuple[TrackedObject, ...], header: Header) -> People:
    people = [_person_to_msg(item) for item in objects if item.state is ObjectState.PERSON]
    return People(header=header, people=people)


def track_markers_to_msg(objects: tuple[TrackedObject, ...], header: Header) -> MarkerArray:
    boxes = [
        _LabeledBox(
            item.track_id,
            item.class_name,
            item.state,
            Pose(position=point_to_msg(item.position_map_m)),
            item.size_m,
        )
        for item in objects
    ]
    return _markers(boxes, header)


def object_map_to_msg(objects: tuple[MapObject, ...], header: Header) -> Detection3DArray:
    """Return the objects at rest, moved ones included, in the header's frame.

    The stamp of a detection is that of the last sighting. Its hypotheses are the classes that were
    detected, each with the mean score of the class over all detections of the object.
    """
    at_rest = [item for item in objects if item.is_present]
    return Detection3DArray(header=header, detections=[_detection(o, header) for o in at_rest])


def object_map_markers_to_msg(objects: tuple[MapObject, ...], header: Header) -> MarkerArray:
    """Return markers of objects that replace all earlier ones: a box and a label for each."""
    boxes = [
        _LabeledBox(
            item.object_id,
            item.class_name,
            item.state,
            conversions.pose_to_msg(item.T_map_object),
            item.size_m,
            item.is_present and item.is_new,
        )
        for item in objects
    ]
    return _markers(boxes, header)


def detailed_object_to_msg(item: MapObject, where: Whereabouts) -> MappedObject:
    """Return an object with its room, places, history and picture."""
    msg = mapped_object_to_msg(item)
    msg.room, msg.places = where.room, where.places
    msg.history = [_event_to_msg(event) for event in item.events]
    msg.picture = array('B', item.jpeg)
    return msg


def mapped_object_to_msg(item: MapObject) -> MappedObject:
    moved_from_m = np.zeros(3) if item.moved_from_map_m is None else item.moved_from_map_m
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
        moved_from=point_to_msg(moved_from_m),
        moved_at=conversions.stamp_to_msg(item.moved_ns),
        colors=item.colors,
    )


def _event_to_msg(event: ObjectEvent) -> ObjectEventMsg:
    return ObjectEventMsg(
        stamp=conversions.stamp_to_msg(event.stamp_ns),
        kind=event.kind.value,
        person=event.person_id,
        distance=event.distance_m,
    )


def _track_to_msg(item: TrackedObject) -> TrackedObjectMsg:
    return TrackedObjectMsg(
        id=item.track_id,
        class_name=item.class_name,
        state=item.state.value,
        score=float(item.score),
        position=point_to_msg(item.position_map_m),
        velocity=vector_to_msg(item.velocity_map_mps),
        size=vector_to_msg(item.size_m),
    )


def _person_to_msg(item: TrackedObject) -> Person:
    return Person(
        name=str(item.track_id),
        position=point_to_msg(item.position_map_m),
        velocity=point_to_msg(item.velocity_map_mps),
        reliability=float(item.score),
    )


def _detection(item: MapObject, header: Header) -> Detection3D:
    pose = conversions.pose_to_msg(item.T_map_object)
    results = []
    for name, score in item.class_scores:
        hypothesis = ObjectHypothesis(class_id=name, score=score / item.num_sightings)
        result = ObjectHypothesisWithPose(hypothesis=hypothesis)
        result.pose.pose = pose
        results.append(result)
    return Detection3D(
        header=conversions.header_to_msg(item.last_ns, header.frame_id),
        results=results,
        bbox=BoundingBox3D(center=pose, size=vector_to_msg(item.size_m)),
        id=str(item.object_id),
    )


def _markers(boxes: Sequence[_LabeledBox], header: Header) -> MarkerArray:
    markers = [Marker(header=header, action=Marker.DELETEALL)]
    for item in boxes:
        states = [] if item.state is ObjectState.AT_REST else [item.state.name.lower()]
        words = ', '.join([*states, *(['new'] if item.is_new else [])])
        box = _marker(item, header, 'objects', Marker.CUBE)
        box.color = _COLORS[item.state]
        box.scale = vector_to_msg(np.maximum(item.size_m, _MIN_SIZE_M))
        label = _marker(item, header, 'labels', Marker.TEXT_VIEW_FACING)
        label.pose.position.z += float(item.size_m[2]) / 2 + _LABEL_M
        label.scale.z = _LABEL_M
        label.color.a = 1.0
        label.text = f'{item.class_name} {item.number}' + (f': {words}' if words else '')
        markers += [box, label]
    return MarkerArray(markers=markers)


def _marker(item: _LabeledBox, header: Header, namespace: str, kind: Any) -> Marker:
    pose = deepcopy(item.pose)
    return Marker(
        header=header, ns=namespace, id=item.number, type=kind, action=Marker.ADD, pose=pose
    )
