"""Parameters that every node of the suite has: subscriptions, autostart, expert parameters."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param, section

BEST_EFFORT = 'best_effort'
RELIABLE = 'reliable'
AUTO = 'auto'


@dataclass(frozen=True)
class InputConfig(Config):
    """Parameters of a node's subscriptions, which `hoid_common.ros.inputs` creates."""

    reliability: str = param(
        AUTO,
        'Reliability that subscriptions request, except for IMU topics, feature_verdicts and the '
        'initial pose. With auto, a subscription is reliable unless a publisher offers best '
        'effort only.',
        choices=(AUTO, BEST_EFFORT, RELIABLE),
        expert=True,
    )
    queue_length: int = param(
        5,
        'Number of messages of each topic, except IMU topics, that wait while the node is busy. '
        'Raise it when messages are lost at short peaks of the load.',
        limits=(1, 1000),
        expert=True,
    )
    compressed: bool = param(
        default=False,
        description='Whether to subscribe to compressed images (.../compressed and '
        '.../compressedDepth) instead of raw ones. Set it to true when the camera runs on another '
        'computer.',
    )
    camera_frame: str = param(
        '',
        'Name of the optical frame of the camera, for drivers that publish an empty frame_id.',
        expert=True,
    )
    depth_offset_s: float = param(
        0.0,
        'Time by which the stamps of depth images are later than those of the color images of the '
        'same instant (s). Set it, for hoid_filter and hoid_scene alike, to the value that '
        'hoid_filter suggests.',
        limits=(-1.0, 1.0),
        expert=True,
    )
    depth_units_per_m: float = param(
        0.0,
        'Number of units of depth images per meter (1/m); 0 means 1000 for whole numbers and 1 '
        'for floats (REP 118). Set it, for hoid_filter and hoid_scene alike, for a driver with '
        'other units, such as 10000 for 0.1 mm.',
        limits=(0.0, 1e6),
        expert=True,
    )


@dataclass(frozen=True)
class NodeConfig(Config):
    """Parameters that every node of the suite has."""

    expert: bool = param(
        default=False,
        description='Whether the node declares its expert parameters. Set it to true to change '
        'one of them.',
    )
    autostart: bool = param(
        default=True,
        description='Whether the node configures and activates itself. Set it to false when a '
        'lifecycle manager does.',
    )
    input: InputConfig = section(InputConfig)
