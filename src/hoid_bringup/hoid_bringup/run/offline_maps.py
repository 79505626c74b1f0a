"""Map files of an offline run: where it starts, and what it leaves."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from hoid_common.errors import ConfigError
from hoid_common.io.files import check_writable
from rgbd_slam.map_io import map_file
from rgbd_slam.scene.dense_state import DenseState
from rgbd_slam.scene.scene_mapper import SceneMapper
from rgbd_slam.session import SlamSession


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


def load(path: Path, session: SlamSession, scene: SceneMapper) -> None:
    """Start with a saved map; raise MapFileError if it is unusable."""
    content = map_file.load(path)
    loaded = session.robot_map.load(content)
    if content.dense is not None:
        scene.load(content.dense, loaded.keyframes, loaded.keyframe_uids)


def save(path: Path, session: SlamSession, scene: SceneMapper) -> None:
    """Save the map, with the dense one if there is one; raise HoidError if that is impossible."""
    content = session.robot_map.export()
    keyframes = session.robot_map.keyframes()
    scene.update_keyframes(keyframes)
    views = scene.views()
    if views:
        content = content._replace(dense=DenseState.of_views(views, keyframes.uids))
    path.parent.mkdir(parents=True, exist_ok=True)
    map_file.save(path, content)
