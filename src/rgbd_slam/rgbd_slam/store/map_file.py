"""A whole map in one database file, as services and commands save and load it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from hoid_common.errors import HoidError, MapFileError
from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.store.database import Database, replaced
from hoid_common.values import CameraModel, IntArray
from rgbd_slam.model.loop_edge import LoopEdge, renumbered
from rgbd_slam.model.map_state import MapState
from rgbd_slam.store.map_check import check_loops, check_map
from rgbd_slam.store.map_parts import part_of
from rgbd_slam.store.map_reader import read_map
from rgbd_slam.store.map_writer import put_header, put_keyframes, put_loops, put_part
from rgbd_slam.store.tables import TABLES, MapHeader

# Chosen: largest ratio of the focal lengths of two cameras that extend the same map.
_MAX_ZOOM = 1.1


class MapFile(NamedTuple):
    """A map with its camera, in the published map frame (z up)."""

    camera: CameraModel  # camera with which the map was made
    scale_factor: float  # ratio of the scales of two successive octaves
    num_octaves: int
    map: MapState
    uids: IntArray | None = None  # (K,) ascending uids of the keyframes; None: equal to their rows
    loops: tuple[LoopEdge, ...] = ()  # loop edges; keyframes are identified by uid
    session: str = ''  # name of the session in which the keyframes had these uids
    stamp_ns: int = 0  # stamp of the last image that was tracked in the map; 0: unknown

    @property
    def loops_by_row(self) -> tuple[LoopEdge, ...]:
        """Return the loop edges, with keyframes identified by their rows in `map`."""
        if self.uids is None:
            return self.loops
        return renumbered(self.loops, {uid: n for n, uid in enumerate(self.uids.tolist())})

    def keyframes(self) -> KeyframePoses:
        uids = np.arange(len(self.map)) if self.uids is None else self.uids
        map_ids = self.map.map_id.astype(np.int64)
        main_map = int(np.bincount(map_ids).argmax())
        return KeyframePoses(1, uids, map_ids, main_map, self.map.T_map_camera)

    def seen_by(
        self, camera: CameraModel, scale_factor: float, num_octaves: int, *, extend: bool
    ) -> MapFile:
        """Return the map as if it had been made with another camera (`MapState.in_camera`).

        Args:
            camera: The camera that will use the map.
            scale_factor: Ratio of the scales of two successive octaves of the camera's features.
            num_octaves: Number of octaves of the camera's features.
            extend: Whether the camera will extend the map. Then its focal length must be similar,
                because features of the two cameras are matched in both directions.

        Raises:
            MapFileError: The octaves differ, or the focal lengths too much to extend the map.
        """
        if (self.scale_factor, self.num_octaves) != (scale_factor, num_octaves):
            raise MapFileError(
                f'the map has features of {self.num_octaves} octaves with scale '
                f'{self.scale_factor:g}: set camera.num_octaves and camera.scale_factor to these'
            )
        if self.camera == camera:
            return self
        if extend:
            check_extendable(self.camera, camera)
        state = self.map.in_camera(self.camera, camera, scale_factor, num_octaves)
        return self._replace(camera=camera, map=state)


def check_extendable(made_with: CameraModel, camera: CameraModel) -> None:
    """Raise MapFileError if the focal lengths of two cameras differ by more than 10 %."""
    zoom = np.sqrt(camera.fx_px * camera.fy_px / made_with.fx_px / made_with.fy_px)
    if abs(np.log(zoom)) > np.log(_MAX_ZOOM):
        raise MapFileError(
            f'the map was made with another camera, {_listed(made_with)}, and this one, '
            f'{_listed(camera)}, differs too much to extend it: localize in it (mode '
            'localization, ./hoid run --localize), or make a new map'
        )


def _listed(camera: CameraModel) -> str:
    return f'{camera.width_px}x{camera.height_px} with fx={camera.fx_px:g} fy={camera.fy_px:g}'


def save(path: Path, content: MapFile) -> int:
    """Write or replace a map file; return its size in bytes. MapFileError if that fails."""
    check(content)
    return _write(path, content)


def load(path: Path) -> MapFile:
    """Return the checked content of a map file; MapFileError if it is damaged or unreadable."""
    try:
        with Database.read(path, TABLES) as database:
            header, uids, state, loops = read_map(database)
        content = MapFile(
            header.camera,
            header.scale_factor,
            header.num_octaves,
            state.moved(header.T_map_core),
            uids,
            loops,
            header.session,
            header.stamp_ns,
        )
        check(content)
    except HoidError as error:
        text = str(error)
        raise MapFileError(text if str(path) in text else f'{path}: {text}') from error
    except MemoryError as error:
        raise MapFileError(f'{path}: does not fit into memory') from error
    except (ValueError, OverflowError, LookupError) as error:  # values that no array can have
        raise MapFileError(f'{path}: is damaged: {error}') from error
    return content


def check(content: MapFile) -> None:
    """Raise MapFileError, which names the first rule that a map breaks."""
    with np.errstate(all='ignore'):  # NaN and infinity fail the checks
        check_map(content.map, content.camera, content.num_octaves)
        check_loops(content.loops)


def _write(path: Path, content: MapFile) -> int:
    header = MapHeader(
        content.camera,
        content.scale_factor,
        content.num_octaves,
        np.eye(4),
        content.session,
        content.stamp_ns,
    )
    part = part_of(content.map, content.uids, content.loops)
    assert part.keyframes is not None
    with replaced(path) as aside:
        with Database.create(aside, TABLES) as database, database.transaction():
            put_header(database, header)
            put_part(database, part)
            put_keyframes(database, part.keyframes)
            put_loops(database, part.loops)
        return aside.stat().st_size
