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
from rgbd_slam.model.keyframe_poses import KeyframePoses
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.scene.fusion_scheduler import FusionRequest, FusionScheduler, Rate
from rgbd_slam.scene.grid import Grid
from rgbd_slam.scene.object_tracker import TrackedObject
from rgbd_slam.scene.scene_mapper import SceneMapper
from rgbd_slam.scene.voxel_map import ColoredCloud
from rgbd_slam.slam import RgbdSlam

Tracks = dict[int, tuple[TrackedObject, ...]]
"""By the stamp (ns) of the image after which they were published."""


class Onlooker(Protocol):
    """Sees the images that the dense map is made of."""

    def fuse(
        self, pose: FusionRequest, frame: RgbdFrame, objects: tuple[DynamicObject, ...]
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
    slam, frames = RgbdSlam(sequence.camera, config.slam), RobotFrames()
    fusion_scheduler = FusionScheduler(config.dense.rate_hz, config.objects.rate_hz)
    room = SceneMapper(sequence.camera, config.dense, config.objects)
    publish = Rate(1 / config.dense.publish_period_s)
    tracks: Tracks = {}

    def keyframes() -> KeyframePoses:
        return frames.keyframes(slam.keyframe_poses())

    for frame in tqdm(sequence, f'{sequence.name} {config.filter.strategy}', unit=' frames'):
        filtered = judge.process(frame, detect(frame))
        if slam.process(filtered.features).T_map_camera is None:
            continue
        T_core_camera, reference_uid = slam.last_pose()
        pose = fusion_scheduler.pick(
            frame.stamp_ns, frames.T_map_core @ T_core_camera, reference_uid, keyframes
        )
        if pose is None:
            continue
        if pose.track_objects:
            tracks[frame.stamp_ns] = room.track_objects(pose, frame.depth_m, filtered.objects)
        if pose.keyframes is not None:
            room.fuse(pose, frame.depth_m, frame.image_bgr, filtered.objects)
            for onlooker in onlookers:
                onlooker.fuse(pose, frame, filtered.objects)
        if publish.take_due(frame.stamp_ns):
            room.grid(room.cloud())  # finds the floor, on which people stand
    slam.finish()
    slam.close()
    room.settle(keyframes())
    cloud = room.cloud()
    return MappedRoom(cloud, room.grid(cloud), tracks)
