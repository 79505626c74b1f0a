"""Frames with ground-truth masks of moving surfaces."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np

from hoid_bags.images import decode_depth, read_image_bytes
from hoid_bags.tum.tum_folder import TumFolder
from hoid_common.io.images import depth_m_from_units
from hoid_common.values import BoolArray, Detections, RgbdFrame
from hoid_synth.acting.stage import Stage, set_stage
from hoid_synth.config import SceneConfig
from hoid_synth.scene import render

_SPECKLE_PX = 5  # opening of the mask: pasted pixels can have the depth that they hide
_STILL_M = 1e-4  # objects that move less from frame to frame count as static


class Labeled(NamedTuple):
    """A frame with the mask of its moving pixels."""

    frame: RgbdFrame
    moving: BoolArray  # (H, W)
    exact: Detections | None  # ground-truth boxes, if known


def pasted_people(people: TumFolder, base: TumFolder) -> Iterator[Labeled]:
    """Yield given frames with people pasted in, and masks of the pasted pixels.

    A pixel counts as moving if its depth differs from the static recording.

    Args:
        people: A copy of the static recording with people pasted into its images.
        base: The static recording, whose depth images have the same stamps.
    """
    kernel = np.ones((_SPECKLE_PX, _SPECKLE_PX), np.uint8)
    without = {image.stamp_ns: image.path for image in base.depth}
    for (_, depth), frame in zip(people.pairs, people, strict=True):
        path = without[depth.stamp_ns]
        units = decode_depth(read_image_bytes(path), path)
        differs = frame.depth_m != depth_m_from_units(units, base.depth_units_per_m)
        closed = cv2.morphologyEx(differs.view(np.uint8), cv2.MORPH_CLOSE, kernel)
        yield Labeled(frame, np.asarray(closed, np.bool_), None)


def rendered_people(config: SceneConfig, workers: int) -> Iterator[Labeled]:
    """Yield the frames of a rendered scene with the masks of people and moving objects."""
    stage = set_stage(config)
    for shown in render(config, workers):
        moving = np.isin(shown.instance_image, _moving_instances(stage, shown.index))
        yield Labeled(shown.frame, moving, shown.detections)


def _moving_instances(stage: Stage, i: int) -> list[int]:
    """Return the instances of people, and of objects whose pose changes around frame i."""
    objects = [
        placed.instance
        for placed, track in zip(stage.world.props, stage.objects, strict=True)
        if np.abs(track.T_world_object[i + 1] - track.T_world_object[max(i - 1, 0)]).max()
        > _STILL_M
    ]
    return [*stage.world.person_instances, *objects]
