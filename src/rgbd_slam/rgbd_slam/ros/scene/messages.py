"""Messages between the SLAM node and the scene process."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from hoid_common.inputs.input_config import InputConfig
from hoid_common.values import CameraModel
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.config.object_config import ObjectTrackerConfig
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.scene.scene_scheduler import SceneRequest
from rgbd_slam.scene.stored_view import StoredView, ViewChange


class SceneSetup(NamedTuple):
    """Parameters of the scene process."""

    name: str  # of its node
    map_frame: str
    is_map_level: bool  # true if the base frame is known
    dense: DenseConfig
    objects: ObjectTrackerConfig
    input: InputConfig


class ClearScene(NamedTuple):
    """Discards the scene until a camera follows."""


class SceneCommand(NamedTuple):
    """Writes files, and asks for a `CommandResult` once all earlier messages are processed."""

    number: int
    cloud_path: Path | None = None  # the file for the dense map
    grid_path: Path | None = None  # the YAML file for the grid; its image is written beside it


SceneMessage = (
    CameraModel
    | ClearScene
    | DenseConfig
    | SceneRequest
    | KeyframePoses
    | StoredView
    | SceneCommand
)
"""A camera starts an empty scene, a configuration replaces the parameters that may change at run
time, and a stored view restores an image of a saved scene or of a process that has died."""


class Output(NamedTuple):
    """A message for a topic."""

    topic: str
    data: bytes  # serialized here, so that the SLAM node's thread need not do it


class CommandResult(NamedTuple):
    """The result of a command."""

    number: int  # of the command
    success: bool
    text: str


SceneReport = Output | CommandResult | ViewChange
