"""Runs filter, SLAM and scene mapper on a rendered recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
from tqdm import tqdm

from hoid_bags.sequence import Sequence as Recording
from hoid_bringup.run.detection_source import detection_source
from hoid_bringup.run.offline import MapFiles
from hoid_bringup.run.run_config import RunConfig
from hoid_common.slam_status import SlamMode
from hoid_common.sync import Rate
from hoid_common.values import DynamicObject, ObjectState, RgbdFrame, Trajectory
from hoid_filter.feature_filter import FeatureFilter
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.grid.grid import Grid
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.scene_scheduler import SceneRequest, SceneScheduler
from hoid_scene.store import scene_file
from hoid_scene.tracks.object_track import TrackedObject
from rgbd_slam.mapping.slam_map import SlamStats
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.session import SlamSession
from rgbd_slam.store import map_file

Tracks = dict[int, tuple[TrackedObject, ...]]
"""Published object tracks by the stamp (ns) of their image."""
ObjectHistory = dict[int, tuple[MapObject, ...]]
"""The objects of the map by the stamp (ns) of the image after which they are listed."""

Verdicts = dict[int, tuple[DynamicObject, ...]]
"""The filter's verdicts on the boxes of each image by its stamp (ns)."""


class FusionObserver(Protocol):
    """Receives the images that are fused into the dense map."""

    def fuse(
        self, pose: SceneRequest, frame: RgbdFrame, objects: tuple[DynamicObject, ...]
    ) -> None:
        """Process an image with the verdicts on its objects."""


@dataclass(frozen=True, eq=False)
class MappedRoom:
    """Dense map, grid, tracks, object map, trajectory and counts of a run."""

    cloud: ColoredCloud
    grid: Grid | None
    tracks: Tracks
    objects: tuple[MapObject, ...]  # of the object map, at the end
    history: ObjectHistory  # the objects of the map after each look
    trajectory: Trajectory  # final poses
    stats: SlamStats
    tentative: tuple[MapObject, ...] = ()  # objects of the map that are not sure, at the end
    verdicts: Verdicts = field(default_factory=dict)


def map_room(
    sequence: Recording,
    config: RunConfig,
    observers: Sequence[FusionObserver] = (),
    files: MapFiles = MapFiles(),  # noqa: B008 - immutable
) -> MappedRoom:
    """Process every frame as the nodes do, and return all maps and tracks.

    Args:
        sequence: The recording.
        config: Parameters of all stages.
        observers: They receive the images that are fused.
        files: Map files to load before the first frame, and to save at the end.
    """
    feature_filter = FeatureFilter(config.filter, sequence.camera)
    session = SlamSession(
        sequence.camera,
        config.slam,
        RobotFrames(),
    )
    scheduler = SceneScheduler(
        config.scene.dense.rate_hz, config.scene.objects.rate_hz, config.scene.object_map.rate_hz
    )
    scene = SceneMapper(
        sequence.camera, config.scene.dense, config.scene.objects, config.scene.object_map
    )
    detect = detection_source(sequence, config, scene.expected_objects)
    if files.load is not None:
        _load(files.load, session, scene, localize=files.localize)
    publish = Rate(1 / config.scene.dense.publish_period_s)
    tracks: Tracks = {}
    history: ObjectHistory = {}
    verdicts: Verdicts = {}
    for frame in tqdm(sequence, f'{sequence.name} {config.filter.strategy}', unit=' frames'):
        filtered = feature_filter.process(frame, detect(frame))
        verdicts[frame.stamp_ns] = filtered.objects
        image = session.process(filtered.features).image
        picked = scheduler.pick(image, session.map.keyframes)
        request = scheduler.narrow(picked, filtered.objects)
        if request is None:
            continue
        if request.track_objects:
            tracks[frame.stamp_ns] = scene.track_objects(request, frame.depth_m, filtered.objects)
        color = partial(np.asarray, frame.image_bgr)
        if scene.map_objects(request, frame.depth_m, filtered.objects, color):
            history[frame.stamp_ns] = scene.mapped_objects()
        if request.fuse:
            scene.fuse(request, frame.depth_m, frame.image_bgr, filtered.objects)
            for observer in observers:
                observer.fuse(request, frame, filtered.objects)
        if publish.take_due(frame.stamp_ns):
            scene.grid(scene.cloud())  # estimates the floor, which the tracks of people need
    session.map.finish()
    session.close()
    scene.correct(session.map.keyframes(), force=True)
    if files.save is not None:
        _save(files.save, session, scene)
    cloud = scene.cloud()
    trajectory = session.map.trajectory('final')
    return MappedRoom(
        cloud,
        scene.grid(cloud),
        tracks,
        scene.mapped_objects(),
        history,
        trajectory,
        session.slam.stats,
        tuple(
            item
            for item in scene.mapped_objects(tentative=True)
            if item.state is ObjectState.TENTATIVE
        ),
        verdicts,
    )


def _load(path: Path, session: SlamSession, scene: SceneMapper, *, localize: bool) -> None:
    content = map_file.load(path)
    uids = session.map.load(content, extend=not localize)
    scene.correct(session.map.keyframes())
    saved = scene_file.read_file(path)
    scene_file.load(scene, saved.renamed(content.keyframes().uids, uids))
    session.set_mode(SlamMode.LOCALIZATION if localize else SlamMode.MAPPING)


def _save(path: Path, session: SlamSession, scene: SceneMapper) -> None:
    map_file.save(path, session.map.export())
    uids = session.map.keyframes().uids
    scene_file.add_to_file(path, scene_file.exported(scene, uids))
