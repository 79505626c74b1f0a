"""Map files of an offline run: where it starts, and what it leaves."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from hoid_common.errors import ConfigError
from hoid_common.io.files import check_writable
from hoid_common.values import CameraModel
from rgbd_slam import map_transfer
from rgbd_slam.config.slam_config import CameraConfig
from rgbd_slam.map_io import map_file
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.scene.dense_state import DenseState
from rgbd_slam.scene.scene_mapper import SceneMapper
from rgbd_slam.slam import RgbdSlam


class MapFiles(NamedTuple):
    """What a run is to do with map files."""

    load: Path | None = None
    localize: bool = False  # leave the loaded map as it is
    save: Path | None = None

    def check(self) -> None:
        """Raise HoidError for what cannot be done."""
        if self.localize and self.load is None:
            raise ConfigError('--localize needs --map FILE')
        if self.save is not None:
            if self.save.is_dir():  # also of `--save-map ''`
                raise ConfigError(f'--save-map {self.save}: is a folder; name a file')
            check_writable(self.save.parent)


class Mapped(NamedTuple):
    """What maps, and of what."""

    slam: RgbdSlam
    room: SceneMapper
    frames: RobotFrames
    camera: CameraModel
    config: CameraConfig


def load(path: Path, into: Mapped) -> None:
    """Start with a saved map; raise MapFileError if it is unusable."""
    content = map_file.load(path)
    loaded = map_transfer.import_map(into.slam, into.frames, into.camera, into.config, content)
    if content.dense is not None:
        into.room.load(content.dense, loaded.keyframes, loaded.keyframe_uids)


def save(path: Path, of: Mapped) -> None:
    """Save the map, with the dense one if there is one; raise HoidError if that is impossible."""
    content = map_transfer.export_map(of.slam, of.frames, of.camera, of.config)
    keyframes = of.frames.keyframes(of.slam.keyframe_poses())
    of.room.update_keyframes(keyframes)
    views = of.room.views()
    if views:
        content = content._replace(dense=DenseState.of_views(views, keyframes.uids))
    path.parent.mkdir(parents=True, exist_ok=True)
    map_file.save(path, content)
