"""What goes between the SLAM node and the process that maps the room."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from hoid_common.inputs.input_config import InputConfig
from hoid_common.values import CameraModel
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.config.object_config import ObjectTrackerConfig
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.scene.dense_mapper import StoredView
from rgbd_slam.scene.fusion_scheduler import FusionRequest
from rgbd_slam.scene.view_ledger import ViewChange


class SceneSetup(NamedTuple):
    """What the process knows from the start."""

    name: str  # of its node
    map_frame: str
    is_map_level: bool  # as it is with a known base
    dense: DenseConfig
    objects: ObjectTrackerConfig
    input: InputConfig


class ClearScene(NamedTuple):
    """Forget the map."""


class KnownView(NamedTuple):
    """An image of the dense map of a process before this one."""

    slot: int  # its number there
    view: StoredView


class Order(NamedTuple):
    """Asks for an answer, once all that was sent before is taken in."""

    number: int
    cloud_path: Path | None = None  # to write the dense map to
    grid_path: Path | None = None  # to write the grid's YAML to, the picture goes beside it


SceneMessage = (
    CameraModel
    | FusionRequest
    | KeyframePoses
    | StoredView
    | KnownView
    | DenseConfig
    | ClearScene
    | Order
)
"""A camera begins a new map; keyframes say where its images are; an image is one saved before;
a configuration replaces what of it may change at run time."""


class Output(NamedTuple):
    """A message for a topic."""

    topic: str
    data: bytes  # serialized, so that the node's thread need not


class Answer(NamedTuple):
    """What came of an order."""

    number: int
    success: bool
    text: str


SceneReport = Output | Answer | ViewChange
