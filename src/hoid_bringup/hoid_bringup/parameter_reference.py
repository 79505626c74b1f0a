"""The page that names every parameter, which `make reference` writes from the nodes' configs."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Any

from hoid_bringup.live.node_specs import NODE_CONFIGS
from hoid_common.config import EXPERT, Param

_HEAD = f"""# Parameters

Written by `make reference` from the nodes' configurations; see
[how to set them](../howto/parameters.md). Those for experts exist where a node is started with
`{EXPERT}:=true`. What can change while the node runs says so.
"""
_MOST_SHOWN = 3  # entries of a list


def parameter_reference() -> str:
    """Return the page, in Markdown: a section for each node, its users' parameters first."""
    parts = [_HEAD]
    for node, config in NODE_CONFIGS.items():
        leaves = list(config.params())
        parts.append(f'\n## {node}\n')
        parts += _table('For users', [leaf for leaf in leaves if not leaf.spec.expert])
        parts += _table('For experts', [leaf for leaf in leaves if leaf.spec.expert])
    return '\n'.join(parts)


def _table(title: str, leaves: Iterable[Param]) -> list[str]:
    head = '| parameter | default | values | what it does |\n|---|---|---|---|'
    return [f'### {title}\n', head, *(_row(leaf) for leaf in leaves), '']


def _row(leaf: Param) -> str:
    free = '' if leaf.spec.read_only else ' *Can change while the node runs.*'
    said = leaf.spec.description.replace('|', '\\|')
    return f'| `{leaf.name}` | {_default(leaf.value)} | {_values(leaf)} | {said}{free} |'


def _default(value: Any) -> str:
    if isinstance(value, tuple):
        more = f' and {len(value) - _MOST_SHOWN} more' if len(value) > _MOST_SHOWN else ''
        return ', '.join(f'`{item}`' for item in value[:_MOST_SHOWN]) + more or '`[]`'
    if isinstance(value, bool):
        return f'`{str(value).lower()}`'
    return f'`{value}`' if value != '' else "`''`"


def _values(leaf: Param) -> str:
    spec = leaf.spec
    if spec.choices:
        return ', '.join(f'`{choice}`' for choice in spec.choices)
    if isinstance(leaf.value, bool):
        return '`true`, `false`'
    if isinstance(leaf.value, tuple):
        return 'list of names'
    if isinstance(leaf.value, str):
        return 'text'
    kind = 'whole number' if isinstance(leaf.value, int) else 'number'
    ends = [f'from {spec.minimum}' if spec.minimum is not None else '']
    ends += [f'to {spec.maximum}' if spec.maximum is not None else '']
    return ' '.join([kind, *filter(None, ends)])


if __name__ == '__main__':
    sys.stdout.write(parameter_reference())
