"""Which processes a replay needs for a bag, and with which topics and parameters. Knows no ROS."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.interfaces import QosReliability

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.bag.bag_source import BagTopic
from hoid_bags.bag.bag_topics import base_name
from hoid_bringup.live.node_specs import DETECTOR, FILTER, SLAM, NodeOptions
from hoid_bringup.live.supervisor import ProcessSpec
from hoid_bringup.run.run_config import TRUTH, RunConfig
from hoid_common import topics
from hoid_common.config import Config, param
from hoid_common.errors import InputError
from hoid_common.inputs.input_config import RELIABLE

PLAYER = 'player'
_SUBSCRIBER_LIMIT_S = 30.0


@dataclass(frozen=True)
class ReplayConfig(Config):
    """How a recording is replayed."""

    rate: float = param(1.0, 'Times real time', minimum=0.01, maximum=100.0)
    lockstep: bool = param(False, 'Hold each image back until the one before has its odometry')
    run: RunConfig = field(default_factory=RunConfig)

    @property
    def uses_truth(self) -> bool:
        """Return whether the bag's exact boxes stand in for a detector."""
        return self.run.needs_detections and self.run.detector.model == TRUTH

    @property
    def nodes(self) -> tuple[str, ...]:
        """Return the nodes that run."""
        needed = self.run.needs_detections and not self.uses_truth
        return (DETECTOR, FILTER, SLAM) if needed else (FILTER, SLAM)


@dataclass(frozen=True)
class BagNames:
    """Topics of a bag as they are played, which is without the leading slash."""

    color: str
    depth: str
    camera_info: str
    true_detections: str | None
    is_compressed: bool
    is_reliable: bool  # as played, so that whoever wants every message can have it

    @classmethod
    def of(cls, bag: BagSequence) -> BagNames:
        """Return the names.

        Raises:
            InputError: The nodes cannot hear this bag.
        """
        found = bag.topics
        if found.camera_info is None:
            raise InputError(f'{bag.path}: has no camera_info, which live nodes need')
        packed = [base_name(t.name) != t.name for t in (found.color, found.depth)]
        if packed[0] != packed[1]:
            raise InputError(
                f'{bag.path}: only one of colour and depth is compressed; nodes take both or '
                'none: convert it anew'
            )
        truth = found.true_detections
        return cls(
            base_name(found.color.name).lstrip('/'),
            base_name(found.depth.name).lstrip('/'),
            found.camera_info.name.lstrip('/'),
            truth.name.lstrip('/') if truth is not None else None,
            packed[0],
            not any(_is_best_effort(t) for t in (found.color, found.depth, found.camera_info)),
        )


def node_options(bag: BagSequence, config: ReplayConfig, folder: Path) -> NodeOptions:
    """Return what the nodes are started with; what services write goes to the folder.

    Raises:
        InputError: The nodes cannot hear this bag, or it lacks the exact boxes asked for.
    """
    names = BagNames.of(bag)
    remappings = [
        (topics.RGB_IMAGE, names.color),
        (topics.DEPTH_IMAGE, names.depth),
        (topics.CAMERA_INFO, names.camera_info),
    ]
    if names.is_compressed:
        remappings += [
            (topics.compressed(topics.RGB_IMAGE), topics.compressed(names.color)),
            (topics.compressed_depth(topics.DEPTH_IMAGE), topics.compressed_depth(names.depth)),
        ]
    if config.uses_truth:
        if names.true_detections is None:
            raise InputError(f'{bag.path}: has no exact boxes for "--detector {TRUTH}"')
        remappings.append((topics.DETECTIONS, names.true_detections))
    of = config.run.changed_of_nodes()
    listening: dict[str, Any] = {'input.compressed': names.is_compressed}
    if config.lockstep and names.is_reliable:
        listening['input.reliability'] = RELIABLE
    return NodeOptions(
        nodes=config.nodes,
        remappings=tuple((a, b) for a, b in remappings if a != b),
        parameters={
            DETECTOR: {**of[DETECTOR], **listening},
            FILTER: {**of[FILTER], **listening},
            SLAM: {**of[SLAM], **listening, 'map_directory': str(folder)},
        },
    )


def player_spec(bag: BagSequence, config: ReplayConfig) -> ProcessSpec:
    """Return the player's command line; it begins when all nodes listen to the images.

    Only what the nodes hear is played: an IMU's thousand messages a second cost all of them time.
    """
    color = bag.topics.color.name.lstrip('/')
    run, found = config.run, bag.topics
    heard = [found.color, found.depth, found.camera_info]
    if config.uses_truth:
        heard.append(found.true_detections)
    looks = (
        run.slam.dense.enabled or run.slam.objects.enabled
    )  # SLAM alone does not look at images
    listeners = len(config.nodes) - (not looks)
    lockstep = ('--lockstep',) if config.lockstep else ()
    return ProcessSpec(
        PLAYER,
        (
            *(sys.executable, '-m', 'hoid_bringup', 'play', str(bag.path)),
            *('--rate', str(config.rate), '--wait', str(_SUBSCRIBER_LIMIT_S)),
            # Stamps are the images' own; /clock would only wake every node 50 times a second.
            *('--no-clock', '--require', f'{color}={listeners}', *lockstep),
            *('--topics', *(topic.name for topic in heard if topic is not None)),
        ),
    )


def _is_best_effort(topic: BagTopic) -> bool:
    return topic.qos is not None and topic.qos.reliability == QosReliability.BEST_EFFORT
