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
        'Reliability that subscriptions request. Choose reliable to have lost messages sent '
        'again; then nothing is received from best-effort publishers. Choose best_effort to '
        'receive from every publisher, without lost messages being sent again. With auto, a '
        'subscription is reliable unless a publisher of its topic offers best effort only.',
        choices=(AUTO, BEST_EFFORT, RELIABLE),
        expert=True,
    )
    queue_length: int = param(
        5,
        'Number of messages of each topic that wait while the node is busy; older messages are '
        'dropped. Raise it when messages are lost at short peaks of the processor load.',
        minimum=1,
        maximum=1000,
        expert=True,
    )
    compressed: bool = param(
        default=False,
        description='Whether to subscribe to the compressed images of image_transport '
        '(.../compressed and .../compressedDepth) instead of the raw images. Set it to true when '
        'the camera runs on another computer.',
    )


@dataclass(frozen=True)
class NodeConfig(Config):
    """Parameters that every node of the suite has."""

    expert: bool = param(
        default=False,
        description='Whether the node declares its expert parameters. Set it to true before you '
        'change an expert parameter in a parameter file or on the command line; otherwise all '
        'expert parameters keep their defaults.',
    )
    autostart: bool = param(
        default=True,
        description='Whether the node configures and activates itself. Set it to false when a '
        'lifecycle manager configures and activates the node.',
    )
    input: InputConfig = section(InputConfig)
