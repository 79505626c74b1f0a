"""What every node of the suite has: how it listens, and the switch for its expert parameters."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param, section

BEST_EFFORT = 'best_effort'
RELIABLE = 'reliable'
AUTO = 'auto'


@dataclass(frozen=True)
class InputConfig(Config):
    """How a node listens; the subscriptions themselves are `hoid_common.ros.inputs`' matter."""

    reliability: str = param(
        AUTO,
        'Reliability that is asked of publishers. With best_effort every publisher is heard; with '
        'reliable a lost message is sent again, but best-effort publishers stay unheard. With '
        'auto it is reliable for compressed images, until a best-effort publisher is there, and '
        'best_effort otherwise.',
        choices=(AUTO, BEST_EFFORT, RELIABLE),
        expert=True,
    )
    queue_length: int = param(
        5, 'Number of messages of each input that are kept while the node is busy.',
        minimum=1, maximum=1000, expert=True,
    )  # fmt: skip
    compressed: bool = param(
        default=False,
        description='Takes images from .../compressed and .../compressedDepth. Set it where the '
        'camera runs on another computer.',
    )


@dataclass(frozen=True)
class NodeConfig(Config):
    """Parameters that every node has."""

    expert: bool = param(
        default=False,
        description='Declares the expert parameters as well. Set it to change one of them, in a '
        'parameter file or on the command line; without it they keep their defaults.',
    )
    autostart: bool = param(
        default=True,
        description='Becomes active at once. Set it to false when a lifecycle manager configures '
        'and activates the node.',
    )
    input: InputConfig = section(InputConfig)
