"""The filter strategies by name: built-in ones and those of other installed packages.

A package adds a strategy by an entry point in the group `hoid_filter.strategies`
(docs/howto/add_a_strategy.md).
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import Any

from hoid_common.errors import ConfigError

ENTRY_POINT_GROUP = 'hoid_filter.strategies'

_BUILT_IN = {
    'none': 'image_rules:NoFilter',
    'person': 'image_rules:PersonOnly',
    'hoid2d': 'image_rules:Hoid2d',
    'hoid3d': 'image_rules:Hoid3d',
    'descriptor': 'image_rules:Descriptor',
    'motion': 'motion_only:MotionOnly',
    'hoid+': 'hoid_plus:HoidPlus',
}


def _find_strategies() -> dict[str, EntryPoint]:
    found = {
        name: EntryPoint(name, f'hoid_filter.strategies.{target}', ENTRY_POINT_GROUP)
        for name, target in _BUILT_IN.items()
    }
    for entry_point in entry_points(group=ENTRY_POINT_GROUP):
        found.setdefault(entry_point.name, entry_point)
    return found


_STRATEGIES = _find_strategies()
STRATEGIES = tuple(_STRATEGIES)


def load_strategy(name: str) -> type[Any]:
    """Return the class of a strategy; ConfigError if it is unknown or cannot be imported."""
    if name not in _STRATEGIES:
        raise ConfigError(f'no strategy is called "{name}"; there are {", ".join(STRATEGIES)}')
    entry_point = _STRATEGIES[name]
    try:
        found: type[Any] = entry_point.load()
    except (ImportError, AttributeError) as error:
        raise ConfigError(
            f'strategy "{name}" cannot be loaded from {entry_point.value}: {error}'
        ) from error
    return found
