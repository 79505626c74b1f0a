"""The cases of the live report. This module does not need ROS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class LiveCase:
    """What is played, with which parameters, and what of the result is subscribed to."""

    sequence: str
    strategy: str = 'hoid+'
    everything: bool = True  # subscribe to all outputs, or to odometry only
    num_cores: int = 2
    rate_hz: float = 30.0


_RECORDED = 'fr1_xyz_people'
_RENDERED = 'synth-1-frames=450'  # 15 s
# One thing at a time differs from the first case.
CASES: Mapping[str, LiveCase] = {
    'all': LiveCase(_RECORDED),
    'pose': LiveCase(_RECORDED, everything=False),
    'motion': LiveCase(_RECORDED, 'motion'),
    'one_core': LiveCase(_RECORDED, num_cores=1),
    '15_hz': LiveCase(_RECORDED, rate_hz=15.0),
    '60_hz': LiveCase(_RECORDED, rate_hz=60.0),
    'rendered_640': LiveCase(_RENDERED),
    'rendered_848': LiveCase(f'{_RENDERED}+width=848'),
    'rendered_1280': LiveCase(f'{_RENDERED}+width=1280'),
}
PUBLISHING = 'publish'
QUICK: Mapping[str, LiveCase] = {
    'rendered_320': LiveCase('synth-1-frames=300+width=320')  # 10 s, which are soon rendered
}
