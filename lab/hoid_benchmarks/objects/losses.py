"""Where the object map loses what a list has: undetected, handled, without surface, not sure."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from hoid_benchmarks.objects.list_scores import MIN_IOU, FoundBoxes, overlap
from hoid_benchmarks.objects.object_list import ListedObject
from hoid_common.values import DynamicObject, ObjectState
from hoid_scene.objects.mapped_object import MapObject
from hoid_synth.truth import box_iou


def why_missed(
    listed: ListedObject,
    objects: Sequence[MapObject],
    boxes: Sequence[FoundBoxes],
    verdicts: Mapping[int, Sequence[DynamicObject]],
    poses: Collection[int],
) -> str:
    """Return the first step at which a listed object was lost, in words.

    Args:
        listed: The object.
        objects: All objects of the map, also those that are not sure or have left.
        boxes: Their boxes in the images of the list, in the same order.
        verdicts: The filter's verdicts on the boxes of images, by stamp [ns].
        poses: Stamps of the images whose pose in the main map is known.
    """
    if listed.boxes_px.keys().isdisjoint(poses):
        return 'no pose in the main map'
    places = np.array([*(overlap(found, listed) for found in boxes), 0.0])
    is_class = np.array([*(item.class_name in listed.classes for item in objects), False])
    for fitting in (places * is_class, places):
        best = int(np.argmax(fitting))
        if fitting[best] >= MIN_IOU:
            return _of_object(objects[best], listed)
    states = _states(listed, verdicts)
    if not states:
        return 'never detected'
    if all(state not in (ObjectState.AT_REST, ObjectState.PREDICTED) for state in states):
        return 'detected, but handled'
    best_iou = float((places * is_class).max())
    return f'detected, but IoU {best_iou:.2f}' if best_iou else 'detected, but no surface'


def _of_object(item: MapObject, listed: ListedObject) -> str:
    if item.class_name not in listed.classes:
        return f'called {item.class_name} in {item.num_sightings} looks'
    if item.state is ObjectState.TENTATIVE:
        return f'not sure: {item.num_sightings} detections of {item.score:.2f}'
    return item.state.name.lower()


def _states(
    listed: ListedObject, verdicts: Mapping[int, Sequence[DynamicObject]]
) -> list[ObjectState]:
    """Return the states of the boxes that show an object in the images of the list."""
    return [
        item.state
        for stamp_ns, box_px in listed.boxes_px.items()
        for item in verdicts.get(stamp_ns, ())
        if item.class_name in listed.classes
        and box_iou(np.array([item.box_xyxy_px], np.float32), box_px[None])[0, 0] >= MIN_IOU
    ]
