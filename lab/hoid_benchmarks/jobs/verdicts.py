"""Verdicts on handled objects, and on objects that a person merely passes in front of.

The ground truth is known for rendered scenes only. Wrong verdicts hardly change a trajectory as
long as enough background is visible; here they are counted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence as Many
from dataclasses import InitVar, dataclass, replace

import numpy as np

from hoid_benchmarks.plan.sequences import scene_of
from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.values import CameraModel, DynamicObject
from hoid_synth.acting.stage import Stage, set_stage
from hoid_synth.truth import TrueObjectState, object_states

_Point = tuple[float, float]


@dataclass
class Verdicts:
    """Counts correct and wrong verdicts over all objects and frames.

    Args:
        scene: Name of the rendered scene, whose ground truth is computed again.
        camera: Camera of the recording.

    Raises:
        InputError: The name is not that of a rendered scene.
    """

    scene: InitVar[str]
    camera: CameraModel
    handled: int = 0
    handled_removed: int = 0
    passed: int = 0  # not handled, but partly covered by a person's box
    passed_removed: int = 0

    def __post_init__(self, scene: str) -> None:
        self._stage = _stage(scene)

    def add(self, i: int, objects: Many[DynamicObject]) -> None:
        """Compare the verdicts on the objects of frame i with the ground truth."""
        for state in object_states(self._stage, i):
            point_px = _project(state, self._stage, i, self.camera)
            seen = _object_at(point_px, state.class_name, objects)
            if seen is None:
                continue
            if state.handled:
                self.handled += 1
                self.handled_removed += seen.is_dynamic
            elif seen.overlap_ratio > 0:
                self.passed += 1
                self.passed_removed += seen.is_dynamic

    def summary(self) -> dict[str, float | int | None]:
        """Return the counts, and the shares of handled objects removed and other objects kept."""
        found = self.handled_removed / self.handled if self.handled else None
        spared = 1 - self.passed_removed / self.passed if self.passed else None
        return {
            'handled': self.handled,
            'passed': self.passed,
            'wrongly_static': self.handled - self.handled_removed,
            'wrongly_dynamic': self.passed_removed,
            'found_share': found,
            'spared_share': spared,
            'balanced': None if found is None or spared is None else (found + spared) / 2,
        }


def _stage(name: str) -> Stage:
    scene = scene_of(name)
    if scene is None:
        raise InputError(f'{name}: handled objects are known for rendered scenes only')
    # A small image width, because fine textures take seconds and are not used.
    return set_stage(replace(scene, width_px=64))


def _project(state: TrueObjectState, stage: Stage, i: int, camera: CameraModel) -> _Point | None:
    """Return the projected center of an object in px; None if it is behind the camera."""
    T_camera_world = se3.inverse(stage.T_world_camera[i])
    x, y, z = se3.transform(T_camera_world, np.array([state.center_m]))[0].tolist()
    if z <= 0:
        return None
    return camera.fx_px * x / z + camera.cx_px, camera.fy_px * y / z + camera.cy_px


def _object_at(
    point_px: _Point | None, class_name: str, objects: Many[DynamicObject]
) -> DynamicObject | None:
    """Return the object of a class whose box contains a point, with the nearest box center."""
    if point_px is None:
        return None
    x, y = point_px
    inside = [
        (math.hypot((x0 + x1) / 2 - x, (y0 + y1) / 2 - y), k)
        for k, o in enumerate(objects)
        for x0, y0, x1, y1 in [o.box_xyxy_px]
        if o.class_name == class_name and x0 <= x <= x1 and y0 <= y <= y1
    ]
    return objects[min(inside)[1]] if inside else None
