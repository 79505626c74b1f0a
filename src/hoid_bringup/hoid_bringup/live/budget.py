"""Limit on the processor cores of the nodes, and parameters that reduce the work on one core."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from hoid_bringup.live.node_specs import DETECTOR, FILTER, NodeOptions
from hoid_common.errors import ConfigError

_LOG = logging.getLogger(__name__)
ONE_CORE: Mapping[str, Mapping[str, Any]] = {
    DETECTOR: {'rate_hz': 5.0},
    FILTER: {'extraction.num_features': 750, 'motion.rate_hz': 15.0},
}
"""Values on one core of parameters that the user has not given (decision 057)."""
_SAID = {
    'rate_hz': 'objects are detected in at most {:g} images per second',
    'motion.rate_hz': 'motion is segmented in at most {:g} images per second',
    'extraction.num_features': 'an image has at most {} features',
}


def use_cores(number: int | None) -> int:
    """Limit this process and its children to a number of cores; return how many are usable.

    None: no further limit. ConfigError if the number is below 1.
    """
    if number is not None and number < 1:
        raise ConfigError(f'--cores {number}: give a number from 1 on')
    usable = sorted(os.sched_getaffinity(0))
    if number is not None and number < len(usable):
        os.sched_setaffinity(0, usable[:number])
        return number
    return len(usable)


def within_budget(options: NodeOptions, num_cores: int) -> NodeOptions:
    """Return options with parameters for less work if there is one core; log the changes.

    The parameters favor odometry in every image. Values that the user has given are kept.
    """
    if num_cores > 1:
        return options
    parameters = {**options.parameters}
    said = []
    for node, values in ONE_CORE.items():
        given = options.given(node)
        added = {name: value for name, value in values.items() if name not in given}
        if node in options.nodes and added:
            parameters[node] = {**parameters.get(node, {}), **added}
            said += [_SAID[name].format(value) for name, value in added.items()]
    if said:
        _LOG.warning('one core: %s', '; '.join(said))
    return replace(options, parameters=parameters)
