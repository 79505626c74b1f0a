"""A rendered recording through filter, SLAM and room mapper, with all that is said of the room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from tqdm import tqdm

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bringup.run.detection_source import detection_source
from hoid_bringup.run.run_config import RunConfig
from hoid_common.values import DynamicObject, RgbdFrame
from hoid_filter.feature_filter import FeatureFilter
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.scene.grid import Grid
from rgbd_slam.scene.object_tracker import TrackedObject
from rgbd_slam.scene.scene_mapper import SceneMapper
from rgbd_slam.scene.scene_scheduler import Rate, SceneRequest, SceneScheduler
from rgbd_slam.scene.voxel_map import ColoredCloud
from rgbd_slam.session import SlamSession

Tracks = dict[int, tuple[TrackedObject, ...]]
"""By the stamp (ns) of the image after which they were published."""


class Onlooker(Protocol):
    """Sees the images that the dense map is made of."""

    def fuse(
        self, pose: SceneRequest, frame: RgbdFrame, objects: tuple[DynamicObject, ...]
    ) -> None:
        """Look at an image with the verdicts on its objects."""


@dataclass(frozen=True, eq=False)
class MappedRoom:
    """What a run leaves."""

    cloud: ColoredCloud
    grid: Grid | None
    tracks: Tracks


def map_room(
    sequence: BagSequence, config: RunConfig, onlookers: Sequence[Onlooker] = ()
) -> MappedRoom:
    """Run every frame, as the nodes do live, and return map, grid and tracks."""
    detect = detection_source(sequence, config)
    judge = FeatureFilter(config.filter, sequence.camera)
    session = SlamSession(
        sequence.camera,
        config.slam,
        RobotFrames(),
        scene_scheduler=SceneScheduler(config.slam.dense.rate_hz, config.slam.objects.rate_hz),
    )
    scene = SceneMapper(sequence.camera, config.slam.dense, config.slam.objects)
    publish = Rate(1 / config.slam.dense.publish_period_s)
    tracks: Tracks = {}
    for frame in tqdm(sequence, f'{sequence.name} {config.filter.strategy}', unit=' frames'):
        filtered = judge.process(frame, detect(frame))
        request = session.process(filtered.features).scene_request
        if request is None:
            continue
        if request.track_objects:
            tracks[frame.stamp_ns] = scene.track_objects(request, frame.depth_m, filtered.objects)
        if request.keyframes is not None:
            scene.fuse(request, frame.depth_m, frame.image_bgr, filtered.objects)
            for onlooker in onlookers:
                onlooker.fuse(request, frame, filtered.objects)
        if publish.take_due(frame.stamp_ns):
            scene.grid(scene.cloud())  # finds the floor, on which people stand
    session.slam.map.finish()
    session.close()
    scene.ledger.correct(session.robot_map.keyframes(), force=True)
    cloud = scene.cloud()
    return MappedRoom(cloud, scene.grid(cloud), tracks)
