"""Ground truth of one frame: boxes of visible pixels, states of objects, places of people."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, ByteArray, Detections, Float32Array, FloatArray
from hoid_synth.acting.stage import Stage

MIN_VISIBLE_PX = 60  # at VGA; instances with fewer visible pixels are not listed


class VisibleObjects(NamedTuple):
    """The visible instances in ascending order; the fields have one entry for each."""

    instances: tuple[int, ...]
    detections: Detections  # ground-truth boxes, scores 1
    handled: tuple[bool, ...]  # whether it is in somebody's hands; False for people


class TrueObjectState(NamedTuple):
    """State of a movable object, whether it is visible or not."""

    instance: int
    class_name: str
    center_m: tuple[float, float, float]  # of its bounding box, in the world frame
    handled: bool
    holder: int  # index of the person who holds it, -1 for nobody


def visible_objects(stage: Stage, i: int, stamp_ns: int, instances: ByteArray) -> VisibleObjects:
    """Return the visible instances that have a class in an instance image (H, W)."""
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
    """Return the middle (P, 3) of each person between floor and head, in the world frame."""
    joints = [stage.joints(n, i) for n in range(len(stage.bodies))]
    centers = [[*(0.5 * (j.pelvis + j.neck))[:2], 0.5 * (j.head[2] + 0.12)] for j in joints]
    return np.array(centers).reshape(-1, 3)


def object_states(stage: Stage, i: int) -> tuple[TrueObjectState, ...]:
    """Return the state of every movable object, handled or not."""
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


def box_iou(a_xyxy: Float32Array, b_xyxy: Float32Array) -> Float32Array:
    """Return the intersection over union (N, M) of boxes (N, 4) and (M, 4)."""
    low = np.maximum(a_xyxy[:, None, :2], b_xyxy[None, :, :2])
    high = np.minimum(a_xyxy[:, None, 2:], b_xyxy[None, :, 2:])
    shared = np.maximum(high - low, 0).prod(axis=2)
    area_a, area_b = ((boxes[:, 2:] - boxes[:, :2]).prod(axis=1) for boxes in (a_xyxy, b_xyxy))
    return np.asarray(shared / np.maximum(area_a[:, None] + area_b - shared, 1e-9))
