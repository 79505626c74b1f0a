"""Names of the nodes' parameters in `--set`, experiments and summaries.

They begin with the short name of the node, as in `filter.strategy`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from hoid_common.config import did_you_mean
from hoid_common.errors import ConfigError

STAGES = {
    'detector': 'hoid_detector',
    'filter': 'hoid_filter',
    'slam': 'rgbd_slam',
    'scene': 'hoid_scene',
}
"""Node of each stage, by the stage's short name."""
SHARED = ('map_directory',)
"""Parameters whose value applies to all nodes that have them, unless a stage is named."""
_SHORT = {node: stage for stage, node in STAGES.items()}


def full_names(name: str, known: Collection[str]) -> Sequence[str]:
    """Return the full name STAGE.PARAMETER; for a shared parameter, one name per node.

    `name` is STAGE.PARAMETER, NODE.PARAMETER, or PARAMETER, if one node has it or all nodes share
    it. ConfigError if it is unknown or ambiguous among the full names in `known`.
    """
    head, _, rest = name.partition('.')
    of_stage = f'{_SHORT.get(head, head)}.{rest}'
    if of_stage in known:
        return [of_stage]
    found = [full for stage in STAGES if (full := f'{stage}.{name}') in known]
    if not found:
        spellings = (name, *(f'{stage}.{name}' for stage in STAGES))
        hint = next(filter(None, (did_you_mean(text, known) for text in spellings)), '')
        raise ConfigError(f'no parameter is called "{name}"{hint}')
    if len(found) > 1 and name not in SHARED:
        raise ConfigError(f'several nodes have a parameter "{name}": write {" or ".join(found)}')
    return found


def by_node(values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    return {
        node: {
            n.removeprefix(f'{stage}.'): v for n, v in values.items() if n.startswith(f'{stage}.')
        }
        for stage, node in STAGES.items()
    }
