"""Messages between the SLAM node and the scene process."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from hoid_common.inputs.input_config import InputConfig
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.values import CameraModel, IntArray
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.config.navigation_config import NavigationConfig
from hoid_scene.config.object_config import ObjectTrackerConfig
from hoid_scene.config.object_map_config import ObjectMapConfig
from hoid_scene.dense.stored_view import StoredView, ViewChange
from hoid_scene.dense.submap_export import ExportMark, SubmapExport
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.objects.object_map_state import ObjectMapState
from hoid_scene.objects.object_query import ObjectQuery
from hoid_scene.scene_scheduler import SceneRequest


class SceneSetup(NamedTuple):
    """Parameters of the scene process."""

    name: str  # of its node
    map_frame: str
    is_map_level: bool  # whether the map frame is level, since a base frame is configured
    dense: DenseConfig
    objects: ObjectTrackerConfig
    object_map: ObjectMapConfig
    input: InputConfig
    remappings: tuple[str, ...] = ()  # rules that the command line has for the SLAM node only
    navigation: NavigationConfig = NavigationConfig()
    folder: Path | None = None  # for the files of the stored images; None: a new temporary folder


class ClearScene(NamedTuple):
    """Discards the scene; the next `CameraModel` starts a new one."""


class Subscribed(NamedTuple):
    """Names of the topics that have subscribers, without /tf_static; see `SceneOutputs`."""

    topics: frozenset[str] = frozenset()


class SavedSubmaps(NamedTuple):
    """Adds the dense map of a saved map, whose keyframes are in the last `KeyframePoses`."""

    path: Path  # a file of `SubmapState`
    keyframe_uids: IntArray  # (K,) present uids of the keyframes, in the order of the saved map


class SavedObjects(NamedTuple):
    """Adds the object map of a saved map, whose keyframes are in the last `KeyframePoses`."""

    state: ObjectMapState
    keyframe_uids: IntArray  # (K,) present uids of the keyframes, in the order of the saved map


class SceneExport(NamedTuple):
    """The maps of the scene for a file, relative to keyframes that are saved with them."""

    submaps: SubmapExport | None  # None: the dense map is off or empty, or there is no scene
    objects: ObjectMapState | None  # None: the object map is off or empty, or there is no scene


class SceneCommand(NamedTuple):
    """Requests files, a list of objects, or that an object is removed; `CommandResult` follows.

    Earlier messages are processed before it, but earlier requests may still wait for their images.
    """

    number: int = -1  # identifies the command in its result; `SceneProcess` sets it
    cloud_path: Path | None = None  # the file for the dense map; None: do not write it
    # The YAML file for the grid, beside which its image is written; None: do not write the grid.
    grid_path: Path | None = None
    # The file for the submaps of the dense map; None, or no dense map: do not write it.
    submaps_path: Path | None = None
    submaps_since: ExportMark | None = None  # only submaps changed since this export; None: all
    # The file for the object map; None, or no object map: do not write it.
    objects_path: Path | None = None
    yaml_path: Path | None = None  # the YAML file for the list of objects; None: do not write it
    query: ObjectQuery | None = None  # which objects the result contains; None: no objects
    forget_id: int | None = None  # number of the object to remove; None: remove none


SceneMessage = (
    CameraModel
    | ClearScene
    | DenseConfig
    | Subscribed
    | SceneRequest
    | KeyframePoses
    | StoredView
    | SavedSubmaps
    | SavedObjects
    | SceneCommand
)
"""A message to the scene process.

A `CameraModel` starts an empty scene, a `DenseConfig` replaces the parameters that may change at
run time, `KeyframePoses` correct the maps, and a `StoredView` restores an image of a saved scene
or of a process that has died.
"""


class Output(NamedTuple):
    """A message that the SLAM node publishes for the scene process."""

    topic: str
    data: bytes  # the message, serialized in the scene process to save time in the SLAM node


class CommandResult(NamedTuple):
    """The result of a command."""

    number: int  # of the command
    success: bool
    text: str  # a message for the user, or the error
    objects: tuple[MapObject, ...] = ()  # those that the command's `query` describes
    stamp_ns: int = 0  # of the latest image that was used; 0: none yet, or the command failed


SceneReport = Output | CommandResult | ViewChange
