"""Exact truth about one frame: boxes of visible pixels, who handles what, who is where."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, ByteArray, Detections, FloatArray
from hoid_synth.acting.stage import Stage

MIN_VISIBLE_PX = 60  # at VGA; what shows less is not listed


class VisibleObjects(NamedTuple):
    """The instances that show, in rising order of instance; rows belong together."""

    instances: tuple[int, ...]
    detections: Detections  # exact boxes, scores 1
    handled: tuple[bool, ...]  # in somebody's hands; people are not


class TrueObjectState(NamedTuple):
    """Where a movable object is, seen or not."""

    instance: int
    class_name: str
    center_m: tuple[float, float, float]  # of its bounding box, world
    handled: bool
    holder: int  # index of the person, -1 when nobody


def visible_objects(stage: Stage, i: int, stamp_ns: int, instances: ByteArray) -> VisibleObjects:
    """Return the labelled instances of an instance image (H, W)."""
    counts = np.bincount(instances.ravel(), minlength=len(stage.world.class_names))
    least = max(4.0, MIN_VISIBLE_PX * stage.config.scale**2)
    shown = [k for k, name in enumerate(stage.world.class_names) if name and counts[k] >= least]
    boxes = np.array([_box(instances == k) for k in shown], np.float32).reshape(-1, 4)
    held = {
        placed.instance
        for placed, track in zip(stage.world.props, stage.objects, strict=True)
        if track.handled[i]
    }
    if stage.world.mover is not None and stage.mover is not None and stage.mover.handled[i]:
        held.add(stage.world.mover[1])
    names = tuple(stage.world.class_names[k] for k in shown)
    detections = Detections(stamp_ns, boxes, names, np.ones(len(shown), np.float32))
    return VisibleObjects(tuple(shown), detections, tuple(k in held for k in shown))


def _box(mask: BoolArray) -> tuple[int, int, int, int]:
    x, y, width, height = cv2.boundingRect(mask.view(np.uint8))
    return x, y, x + width, y + height


def people_centers(stage: Stage, i: int) -> FloatArray:
    """Return (P, 3) the middle of each person, between the feet's floor and the head, world."""
    joints = [stage.joints(n, i) for n in range(len(stage.bodies))]
    centers = [[*(0.5 * (j.pelvis + j.neck))[:2], 0.5 * (j.head[2] + 0.12)] for j in joints]
    return np.array(centers).reshape(-1, 3)


def object_states(stage: Stage, i: int) -> tuple[TrueObjectState, ...]:
    """Return the state of every movable object, also of those that nobody touches."""
    states = []
    for placed, track in zip(stage.world.props, stage.objects, strict=True):
        vertices = placed.prop.mesh.vertices_m
        middle = 0.5 * (vertices.min(0) + vertices.max(0)).astype(float)
        x, y, z = se3.transform(track.T_world_object[i], middle[None])[0].tolist()
        states.append(
            TrueObjectState(
                placed.instance,
                placed.prop.class_name,
                (x, y, z),
                bool(track.handled[i]),
                int(track.holder[i]),
            )
        )
    return tuple(states)
