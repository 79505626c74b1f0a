"""What goes from the SLAM node to the process that maps the room."""

from __future__ import annotations

from typing import NamedTuple

from hoid_common.input_config import InputConfig
from hoid_common.values import CameraModel
from rgbd_slam.config.dense_config import DenseConfig
from rgbd_slam.config.object_config import ObjectTrackerConfig
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.scene.dense_mapper import StoredView
from rgbd_slam.scene.fusion_scheduler import FusionRequest


class SceneSetup(NamedTuple):
    """What the process knows from the start."""

    slam_node: str  # fully qualified name of the node that it belongs to
    map_frame: str
    map_directory: str
    dense: DenseConfig
    objects: ObjectTrackerConfig
    input: InputConfig


class ClearScene(NamedTuple):
    """Forget the map."""


class StoredViewsRequest(NamedTuple):
    """Send the images of the dense map back, one by one, and then None."""


SceneMessage = (
    CameraModel
    | FusionRequest
    | KeyframePoses
    | StoredView
    | DenseConfig
    | StoredViewsRequest
    | ClearScene
)
"""A camera begins a new map; keyframes say where its images are; an image is one saved before;
a configuration replaces what of it may change at run time."""
