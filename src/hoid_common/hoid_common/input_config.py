"""How a node listens; the subscriptions themselves are `hoid_common.ros.inputs`' matter."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param

BEST_EFFORT = 'best_effort'
RELIABLE = 'reliable'


@dataclass(frozen=True)
class InputConfig(Config):
    """How a node listens."""

    reliability: str = param(
        BEST_EFFORT,
        'reliability that is asked of publishers; best_effort hears all of them',
        choices=(BEST_EFFORT, RELIABLE),
    )
    queue_length: int = param(5, 'messages kept per input while busy', minimum=1, maximum=1000)
    compressed: bool = param(
        default=False, description='take images from .../compressed and .../compressedDepth'
    )
