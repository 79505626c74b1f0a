"""Saved maps in the frame that users see: export_map from a running session, and laid over one."""

from __future__ import annotations

from typing import NamedTuple

from hoid_common import se3
from hoid_common.errors import ConfigError
from hoid_common.values import CameraModel, IntArray
from rgbd_slam.config.slam_config import CameraConfig
from rgbd_slam.map_io.map_file import MapFile
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.slam import RgbdSlam


class LoadedMap(NamedTuple):
    """A saved map's place in the running one."""

    keyframe_uids: IntArray  # (K,) of the saved keyframes
    keyframes: KeyframePoses  # all there are now, in the map frame


def export_map(
    slam: RgbdSlam, frames: RobotFrames, camera: CameraModel, config: CameraConfig
) -> MapFile:
    """Copy the map, without a dense one, for a file; takes a few ms.

    Raises:
        ConfigError: There is no map.
    """
    if slam.map.is_empty:
        raise ConfigError('nothing has been mapped yet: there is nothing to save')
    state = slam.map.state().moved(frames.T_map_core)
    return MapFile(camera, config.scale_factor, config.num_octaves, state)


def import_map(
    slam: RgbdSlam,
    frames: RobotFrames,
    camera: CameraModel,
    config: CameraConfig,
    content: MapFile,
    *,
    keep: bool = False,
) -> LoadedMap:
    """Lay a saved map over the running one, between two images.

    Args:
        slam: What runs.
        frames: Where its camera sits; the map frame becomes that of the saved map.
        camera: Its camera.
        config: Its features.
        content: What was saved.
        keep: Go on in the running map, until a place of the saved one is seen; otherwise it is
            gone, and the camera is looked for in the saved one.

    Raises:
        MapFileError: The map is of another camera; the running one is as before.
    """
    content.check_fits(camera, config.scale_factor, config.num_octaves)
    uids = slam.load(content.map.moved(se3.inverse(frames.T_map_core)), keep=keep)
    return LoadedMap(uids, frames.keyframes(slam.map.keyframe_poses()))
