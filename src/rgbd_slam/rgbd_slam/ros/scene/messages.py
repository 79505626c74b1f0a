"""Messages between the SLAM node and the scene process."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from hoid_common.inputs.input_config import InputConfig
from hoid_common.values import CameraModel, IntArray
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.config.object_config import ObjectTrackerConfig
from rgbd_slam.config.object_map_config import ObjectMapConfig
from rgbd_slam.dense.stored_view import StoredView, ViewChange
from rgbd_slam.dense.submap_export import ExportMark
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.scene.scene_scheduler import SceneRequest


class SceneSetup(NamedTuple):
    """Parameters of the scene process."""

    name: str  # of its node
    map_frame: str
    is_map_level: bool  # true if the base frame is known
    dense: DenseConfig
    objects: ObjectTrackerConfig
    object_map: ObjectMapConfig
    input: InputConfig
    remappings: tuple[str, ...] = ()  # rules that the command line has for the SLAM node only
    folder: Path | None = None  # for the files of the stored images; None: one of its own


class ClearScene(NamedTuple):
    """Discards the scene; the next `CameraModel` starts a new one."""


class Subscribed(NamedTuple):
    """Names of the topics that have subscribers; messages are made only for these."""

    topics: frozenset[str] = frozenset()


class SavedSubmaps(NamedTuple):
    """Adds the dense map of a saved map, whose keyframes are in the last `KeyframePoses`."""

    path: Path  # a file of `SubmapState`
    keyframe_uids: IntArray  # (K,) present uids of the keyframes, in the order of the saved map


class SceneCommand(NamedTuple):
    """Asks to write files, and for a `CommandResult` after all earlier messages are processed."""

    number: int  # identifies the command in its result
    cloud_path: Path | None = None  # the file for the dense map; None: do not write it
    # The YAML file for the grid, beside which its image is written; None: do not write the grid.
    grid_path: Path | None = None
    # The file for the submaps of the dense map; None, or no dense map: do not write it.
    submaps_path: Path | None = None
    submaps_since: ExportMark | None = None  # only what has changed since; None: everything


SceneMessage = (
    CameraModel
    | ClearScene
    | DenseConfig
    | Subscribed
    | SceneRequest
    | KeyframePoses
    | StoredView
    | SavedSubmaps
    | SceneCommand
)
"""A message to the scene process.

A camera starts an empty scene, a configuration replaces the parameters that may change at run
time, and a stored view restores an image of a saved scene or of a process that has died.
"""


class Output(NamedTuple):
    """A message that the SLAM node publishes for the scene process."""

    topic: str
    data: bytes  # serialized here, so that the SLAM node's thread need not do it


class CommandResult(NamedTuple):
    """The result of a command."""

    number: int  # of the command
    success: bool
    text: str


SceneReport = Output | CommandResult | ViewChange
