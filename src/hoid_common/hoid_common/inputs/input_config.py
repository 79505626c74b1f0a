"""Parameters that every node of the suite has: subscriptions, autostart, expert parameters."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param, section

BEST_EFFORT = 'best_effort'
RELIABLE = 'reliable'
AUTO = 'auto'


@dataclass(frozen=True)
class InputConfig(Config):
    """Parameters of a node's subscriptions, which `hoid_common.ros.inputs` makes."""

    reliability: str = param(
        AUTO,
        'Reliability that subscriptions request. A best_effort subscription receives from every '
        'publisher; with reliable, lost messages are sent again, but nothing is received from '
        'best-effort publishers. With auto it is reliable for compressed images, unless a '
        'publisher offers only best effort, and best_effort otherwise.',
        choices=(AUTO, BEST_EFFORT, RELIABLE),
        expert=True,
    )
    queue_length: int = param(
        5,
        'Number of messages of each input that wait while the node is busy.',
        minimum=1,
        maximum=1000,
        expert=True,
    )
    compressed: bool = param(
        default=False,
        description='Whether to subscribe to .../compressed and .../compressedDepth instead of '
        'the raw images. Set it to true when the camera runs on another computer.',
    )


@dataclass(frozen=True)
class NodeConfig(Config):
    """Parameters that every node of the suite has."""

    expert: bool = param(
        default=False,
        description='Whether the node declares its expert parameters. Set it to true to change '
        'one of them in a parameter file or on the command line; otherwise they keep their '
        'defaults.',
    )
    autostart: bool = param(
        default=True,
        description='Whether the node configures and activates itself. Set it to false when a '
        'lifecycle manager does.',
    )
    input: InputConfig = section(InputConfig)
