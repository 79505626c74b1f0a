"""Reading of untrusted YAML files: plain data of limited size only.

Tags and aliases are refused, because an alias can expand exponentially; dates and numbers in base
60 are read as text.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, cast

import yaml

from hoid_common.errors import ConfigError, InputError, prefixed
from hoid_common.io.untrusted import read_text

# Chosen, not tuned: a file beyond these limits is refused. Files of parameters, cameras or plans
# are far smaller.
MAX_BYTES = 500_000
MAX_DEPTH = 20  # levels of nesting
MAX_NODES = 30_000  # values and keys
_MAX_DIGITS = 40  # characters of a number; a float64 needs at most 24
_INT64 = range(-(2**63), 2**63)
_SHOWN_CHARS = 60  # number of characters that an error quotes of a value
# Plain values as ROS's parameter parser reads them: `1e3` is a float, unlike in PyYAML.
_BOOLS = re.compile(
    r'(?:yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF)$'
)
_INT = re.compile(r'[-+]?(?:0|[1-9][0-9]*|0x[0-9a-fA-F]+)$')
_FLOAT = re.compile(
    r'(?:[-+]?(?:\.[0-9]+|[0-9]+\.[0-9]*)(?:[eE][-+]?[0-9]+)?|[-+]?[0-9]+[eE][-+]?[0-9]+'
    r'|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$'
)
_NULL = re.compile(r'(?:~|null|Null|NULL|)$')


def read_yaml(path: Path) -> Any:
    """Return the plain data in a YAML file; InputError if it cannot be read or is not plain."""
    text = read_text(path, MAX_BYTES)
    return parse_yaml(text, str(path))


def parse_yaml(text: str, source: str) -> Any:
    """Return the plain data in a YAML text; InputError, naming `source`, if it is not plain."""
    if len(text) > MAX_BYTES:
        raise InputError(f'{source}: larger than {MAX_BYTES / 1e6:g} MB')
    try:
        return yaml.load(text, Loader=_PlainLoader)  # noqa: S506 (plain values only)
    except yaml.YAMLError as error:
        raise InputError(f'{source}: is not YAML ({_line(error)})') from error


class _PlainLoader(yaml.SafeLoader):
    """SafeLoader with limits, and without tags, aliases, dates and numbers in base 60."""

    yaml_implicit_resolvers: ClassVar[dict[str, list[tuple[str, re.Pattern[str]]]]] = {}

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = self._num_nodes = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            raise _refusal('an alias; write the value again', event.start_mark)
        if getattr(event, 'tag', None) is not None:
            raise _refusal(f'the tag {_cut(event.tag)}; write the plain value', event.start_mark)
        if self._depth > MAX_DEPTH:
            raise _refusal(f'nested deeper than {MAX_DEPTH}', event.start_mark)
        self._num_nodes += 1
        if self._num_nodes > MAX_NODES:
            raise _refusal(f'more than {MAX_NODES} values', event.start_mark)
        self._depth += 1
        try:
            return cast('yaml.Node | None', super().compose_node(parent, index))
        finally:
            self._depth -= 1

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Do nothing: without aliases, `<<` is a plain key and no merge."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        known: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _refusal('a key that is a list or a mapping', key.start_mark)
            if key.value in known:
                raise _refusal(f'the key "{_cut(key.value)}" twice', key.start_mark)
            known.add(key.value)
        return cast('dict[Any, Any]', super().construct_mapping(node, deep=deep))

    def number(self, node: yaml.ScalarNode) -> int | float:
        text: str = node.value
        if len(text) > _MAX_DIGITS:
            raise _refusal(f'a number of {len(text)} characters', node.start_mark)
        if not _INT.match(text):
            return float(text.lower().replace('.inf', 'inf').replace('.nan', 'nan'))
        value = int(text, 0)
        if value not in _INT64:
            raise _refusal(f'the number {_cut(text)}, which is beyond 64 bits', node.start_mark)
        return value


def _refusal(what: str, mark: yaml.Mark) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=what, problem_mark=mark)


def _cut(text: str) -> str:
    return text if len(text) <= _SHOWN_CHARS else f'{text[:_SHOWN_CHARS]}...'


def _line(error: yaml.YAMLError) -> str:
    mark = getattr(error, 'problem_mark', None)
    where = '' if mark is None else f'line {mark.line + 1}: '
    what = getattr(error, 'problem', None) or getattr(error, 'reason', None) or 'unreadable'
    return ascii(f'{where}{" ".join(_cut(str(what)).split())}')[1:-1]


for _tag, _pattern, _first in (
    ('bool', _BOOLS, 'yYnNtTfFoO'),
    ('int', _INT, '-+0123456789'),
    ('float', _FLOAT, '-+0123456789.'),
    ('null', _NULL, ['~', 'n', 'N', '']),
):
    _PlainLoader.add_implicit_resolver(f'tag:yaml.org,2002:{_tag}', _pattern, list(_first))
for _tag in ('int', 'float'):
    _PlainLoader.add_constructor(f'tag:yaml.org,2002:{_tag}', _PlainLoader.number)


def load_params(path: Path, node_name: str) -> dict[str, Any]:
    """Return the parameters, by dotted name, that a parameter file sets for a node.

    Sections are `/**` and those of the node's name, in any namespace; later sections override
    earlier ones. Lists become tuples. ConfigError if it is not a parameter file.
    """
    with prefixed('', ConfigError, InputError):
        content = read_yaml(path)
    if not isinstance(content, Mapping):
        raise ConfigError(f'{path}: is not a ROS parameter file')
    values: dict[str, Any] = {}
    for section, body in content.items():
        if section == '/**' or str(section).rsplit('/', maxsplit=1)[-1] == node_name:
            if not isinstance(body, Mapping) or not isinstance(
                body.get('ros__parameters'), Mapping
            ):
                raise ConfigError(f'{path}: section "{section}" has no "ros__parameters"')
            values |= _flat(body['ros__parameters'])
    return values


def _flat(tree: Mapping[Any, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f'{prefix}{name}.')
        else:
            yield f'{prefix}{name}', tuple(value) if isinstance(value, list) else value
