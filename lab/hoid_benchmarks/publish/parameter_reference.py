"""Generator of the reference page of all parameters of the nodes (`make reference`)."""

from __future__ import annotations

import sys
from math import inf
from typing import Any

from hoid_bringup.live.node_specs import NODE_CONFIGS
from hoid_common.config import EXPERT, Param

_HEAD = f"""# Parameters

Written by `make reference` from the nodes' configurations; see
[how to set them](../howto/parameters.md). In brackets: the default, and the values that are
possible. Parameters for experts exist only if the node is started with `{EXPERT}:=true`. *Live*:
the parameter can change while the node runs.
"""
_SHARED = 'All nodes'  # title of the section of parameters that every node has
_MAX_ENTRIES = 3  # largest number of entries of a list that are shown


def parameter_reference() -> str:
    """Return the page in Markdown, with two lists per node: for users and for experts."""
    of_nodes = {node: list(config.node_params()) for node, config in NODE_CONFIGS.items()}
    first, *others = of_nodes.values()
    shared = [leaf for leaf in first if all(leaf in leaves for leaves in others)]
    sections = {_SHARED: shared}
    for node, leaves in of_nodes.items():
        sections[node] = [leaf for leaf in leaves if leaf not in shared]
    parts = [_HEAD]
    for name, leaves in sections.items():
        parts.append(f'\n## {name}\n')
        for title, is_expert in (('For users', False), ('For experts', True)):
            rows = [_row(leaf) for leaf in leaves if leaf.spec.expert == is_expert]
            parts += [f'### {title}\n', *rows, '']
    return '\n'.join(parts)


def _row(leaf: Param) -> str:
    note = '' if leaf.spec.read_only else ' *Live.*'
    values = '; '.join(filter(None, (_default(leaf.value), _values(leaf))))
    return f'- `{leaf.name}` ({values}): {leaf.spec.description}{note}'


def _default(value: Any) -> str:
    if isinstance(value, tuple):
        num_more = len(value) - _MAX_ENTRIES
        more = f' and {num_more} more' if num_more > 0 else ''
        return ', '.join(f'`{item}`' for item in value[:_MAX_ENTRIES]) + more or '`[]`'
    if isinstance(value, bool):
        return f'`{str(value).lower()}`'
    return f'`{value}`' if value != '' else "`''`"


def _values(leaf: Param) -> str:
    """Return the values that a parameter may have, such as `integer, [0, 5]` or `>= 0.0`."""
    spec = leaf.spec
    if spec.choices:
        return ', '.join(f'`{choice}`' for choice in spec.choices)
    if isinstance(leaf.value, bool):
        return ''
    kind = {tuple: 'names', str: 'text', int: 'integer'}
    low, high = spec.limits
    limits = f'>= {low}' if high == inf else f'[{low}, {high}]'
    limits = limits if low > -inf else ''
    return ', '.join(filter(None, (kind.get(type(leaf.value), ''), limits))) or 'number'


if __name__ == '__main__':
    sys.stdout.write(parameter_reference())
