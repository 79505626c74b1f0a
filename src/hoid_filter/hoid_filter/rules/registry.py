"""The strategies by name."""

from __future__ import annotations

from hoid_filter.config import FilterConfig
from hoid_filter.detections.aligned_detections import Strategy
from hoid_filter.rules.hoid_plus import HoidPlus
from hoid_filter.rules.motion_only import MotionOnly
from hoid_filter.rules.strategies import (
    Descriptor,
    Hoid2d,
    Hoid3d,
    ImageRule,
    NoFilter,
    PersonOnly,
)

_IMAGE_RULES: dict[str, type[ImageRule]] = {
    'person': PersonOnly,
    'hoid2d': Hoid2d,
    'hoid3d': Hoid3d,
    'descriptor': Descriptor,
}


def make_strategy(config: FilterConfig) -> Strategy:
    """Return a fresh strategy of the name that the config holds."""
    if config.strategy == 'none':
        return NoFilter(config)
    if config.strategy == 'motion':
        return MotionOnly(config)
    if config.strategy == 'hoid+':
        return HoidPlus(config)
    return _IMAGE_RULES[config.strategy](config)
