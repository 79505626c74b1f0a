"""What the parameters of the three nodes are called in `--set`, experiments and summaries."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from hoid_common.config import did_you_mean
from hoid_common.errors import ConfigError

STAGES = {'detector': 'hoid_detector', 'filter': 'hoid_filter', 'slam': 'rgbd_slam'}
"""Each stage's short name and its node."""
_SHORT = {node: stage for stage, node in STAGES.items()}


def full_name(name: str, known: Collection[str]) -> str:
    """Return STAGE.PARAMETER for what somebody calls a parameter.

    Args:
        name: STAGE.PARAMETER, NODE.PARAMETER, or a PARAMETER that only one node has.
        known: The full names there are.

    Raises:
        ConfigError: Nothing is called that, or parameters of several nodes are.
    """
    head, _, rest = name.partition('.')
    found = list(_matches(name, f'{_SHORT.get(head, head)}.{rest}', known))
    if not found:
        spelt = (name, *(f'{stage}.{name}' for stage in STAGES))
        meant = next(filter(None, (did_you_mean(text, known) for text in spelt)), '')
        raise ConfigError(f'no parameter is called "{name}"{meant}')
    if len(found) > 1:
        raise ConfigError(f'several nodes have "{name}": say {" or ".join(found)}')
    return found[0]


def by_node(values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return what is given by full name by node instead, and by the node's own name."""
    return {
        node: {
            n.removeprefix(f'{stage}.'): v for n, v in values.items() if n.startswith(f'{stage}.')
        }
        for stage, node in STAGES.items()
    }


def _matches(name: str, of_stage: str, known: Collection[str]) -> Iterator[str]:
    if of_stage in known:
        yield of_stage
    else:
        yield from (full for stage in STAGES if (full := f'{stage}.{name}') in known)
