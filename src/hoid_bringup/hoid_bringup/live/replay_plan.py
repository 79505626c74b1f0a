"""The processes of a replay with their topics and parameters, in code without ROS."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.interfaces import QosReliability

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.bag.contents import BagTopic
from hoid_bags.storage.bag_types import COMPRESSED_IMAGE
from hoid_bringup.live.budget import use_cores, within_budget
from hoid_bringup.live.node_specs import DETECTOR, FILTER, SCENE, SLAM, NodeOptions
from hoid_bringup.live.supervisor import ProcessSpec
from hoid_bringup.run.parameter_names import by_node
from hoid_bringup.run.run_config import NO_TRUTH, TRUTH, RunConfig
from hoid_common import topics
from hoid_common.config import Config, param
from hoid_common.errors import InputError
from hoid_common.inputs.input_config import RELIABLE
from hoid_common.topics import is_compressed
from hoid_common.values import NS_PER_S

PLAYER = 'player'
_SUBSCRIBER_TIMEOUT_S = 30.0  # not tuned: discovery takes a second or two


@dataclass(frozen=True)
class ReplayConfig(Config):
    """Parameters of a replay."""

    rate: float = param(
        1.0,
        'Speed as a multiple of real time. Lower it on a slow computer.',
        limits=(0.01, 100.0),
    )
    lockstep: bool = param(
        False,
        'Whether to publish each image only after the odometry of the previous image. Set it to '
        'true so that a slow computer loses no image.',
    )
    run: RunConfig = field(default_factory=RunConfig)
    # Topics of an IMU in the bag: one with both sensors, or one of the gyro and one of the
    # accelerometer.
    imu: tuple[str, ...] = ()

    @property
    def uses_truth(self) -> bool:
        return self.run.needs_detections and self.run.detector.model == TRUTH

    @property
    def nodes(self) -> tuple[str, ...]:
        """Return the nodes to run; detector and scene are among them only if they are needed."""
        scene = self.run.scene
        is_needed = {
            DETECTOR: self.run.needs_detections and not self.uses_truth,
            SCENE: any(p.enabled for p in (scene.dense, scene.objects, scene.object_map)),
        }
        return tuple(n for n in (DETECTOR, FILTER, SLAM, SCENE) if is_needed.get(n, True))


def camera_info_topic(bag: BagSequence) -> BagTopic:
    """Return the camera_info topic of a bag; InputError if it is missing, as nodes need it."""
    if bag.topics.camera_info is None:
        raise InputError(
            f'{bag.path}: has no camera_info topic, which the nodes need; record it, or use '
            '"hoid run --calibration"'
        )
    return bag.topics.camera_info


def node_options(bag: BagSequence, config: ReplayConfig, folder: Path) -> NodeOptions:
    """Return the options with which nodes process a bag and save files in `folder`.

    InputError if the bag lacks a topic, or the nodes cannot subscribe to an image topic.
    """
    changed, inputs = by_node(config.run.changed()), _inputs(bag, config)
    options = NodeOptions(
        nodes=config.nodes,
        remappings=_remappings(bag, config),
        parameters={
            DETECTOR: {**changed[DETECTOR], **inputs},
            FILTER: {**changed[FILTER], **inputs},
            SLAM: {**changed[SLAM], **inputs, 'map_directory': str(folder)},
            SCENE: {**changed[SCENE], **inputs, 'map_directory': str(folder)},
        },
    )
    return within_budget(options, use_cores(None))


def _remappings(bag: BagSequence, config: ReplayConfig) -> tuple[tuple[str, str], ...]:
    found = bag.topics
    for topic in (found.color, found.depth):
        if is_compressed(topic.name) != (topic.type_name == COMPRESSED_IMAGE):
            raise InputError(
                f'{bag.path}: {topic.name} is {topic.type_name}, but its name says otherwise, '
                'so that the nodes cannot subscribe to it: use "hoid run"'
            )
    names = {
        topics.RGB_IMAGE: found.color.name,
        topics.DEPTH_IMAGE: found.depth.name,
        topics.CAMERA_INFO: camera_info_topic(bag).name,
        **dict(zip((topics.IMU, topics.ACCELEROMETER), config.imu, strict=False)),
    }
    if config.uses_truth:
        if found.true_detections is None:
            raise InputError(f'{bag.path}: {NO_TRUTH}')
        names[topics.DETECTIONS] = found.true_detections.name
    relative = [(own, name.lstrip('/')) for own, name in names.items()]
    return tuple((own, name) for own, name in relative if own != name)


def _inputs(bag: BagSequence, config: ReplayConfig) -> dict[str, Any]:
    """Return the parameters `input.*` that all nodes need for the images of a bag."""
    inputs: dict[str, Any] = {}
    if bag.depth_offset_ns:
        inputs['input.depth_offset_s'] = bag.depth_offset_ns / NS_PER_S
    if bag.depth_units_per_m:
        inputs['input.depth_units_per_m'] = bag.depth_units_per_m
    played = (bag.topics.color, bag.topics.depth, camera_info_topic(bag))
    if config.lockstep and not any(map(_is_best_effort, played)):
        inputs['input.reliability'] = RELIABLE
    return inputs


def player_spec(bag: BagSequence, config: ReplayConfig) -> ProcessSpec:
    """Return the command line of the process that plays the bag.

    It begins to play when all nodes that need color images have subscribed, and ends with an error
    if they have not after 30 s. Only topics that the nodes need are played, because an unused IMU
    with a thousand messages per second would take processor time from all nodes (decision 018).
    """
    found = bag.topics
    color = found.color.name.lstrip('/')
    played = [found.color, found.depth, found.camera_info]
    if config.uses_truth:
        played.append(found.true_detections)
    if found.depth_info is not None:  # the nodes need them to map depth to color
        played += [found.depth_info, found.static_frames]
    num_subscribers = len(config.nodes) - 1  # SLAM receives no images
    offset = ('--depth-offset', str(bag.depth_offset_ns / NS_PER_S)) if bag.depth_offset_ns else ()
    images = ('--rgb', found.color.name, '--depth', found.depth.name, *offset)
    lockstep = ('--lockstep', *images) if config.lockstep else ()
    return ProcessSpec(
        PLAYER,
        (
            *(sys.executable, '-m', 'hoid_bringup', 'play', str(bag.path)),
            *('--rate', str(config.rate), '--wait', str(_SUBSCRIBER_TIMEOUT_S)),
            # /clock is not played: it would wake each node 50 times a second, and none needs it
            # (decision 018).
            *('--no-clock', '--require', f'{color}={num_subscribers}', *lockstep),
            *('--topics', *(topic.name for topic in played if topic is not None), *config.imu),
        ),
    )


def _is_best_effort(topic: BagTopic) -> bool:
    return topic.qos is not None and topic.qos.reliability == QosReliability.BEST_EFFORT
