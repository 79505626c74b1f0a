"""Configuration by frozen dataclasses that declare default, description and range of each field.

A configuration derives from `Config` and declares each parameter with `param(...)`, each nested
configuration with `section(...)`. Names are dotted (`extraction.num_features`), the same in
Python, YAML and ROS. Constants are class variables.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from difflib import get_close_matches
from math import inf
from typing import Any, NamedTuple, Self, TypeVar, cast

from hoid_common.errors import ConfigError

C = TypeVar('C', bound='Config')

EXPERT = 'expert'
"""Name of the boolean parameter with which a node declares its expert parameters."""

_SPEC, _EXPERT_SECTION = 'hoid_param', 'hoid_expert'  # keys of a dataclass field's metadata
# Chosen: difflib's similarity ratio from which all similar names are suggested (one or two letters
# differ). If no name reaches it, the most similar one is suggested from the lower ratio on (two
# letters of a three-letter word are swapped).
_MIN_SIMILARITY, _MIN_OF_BEST = 0.8, 0.6
_MAX_SUGGESTIONS = 3


@dataclass(frozen=True)
class ParamSpec:
    """Metadata of a parameter: description and constraints. The field has type and default."""

    description: str  # full sentences, with the unit of a number
    limits: tuple[float, float] = (-inf, inf)  # inclusive range of a number
    choices: tuple[str, ...] = ()  # the only values of a string; empty = any
    read_only: bool = True  # True: the parameter cannot change while the node runs
    expert: bool = False  # True: a node declares the parameter only with `expert:=true`
    is_internal: bool = False  # True: it is no ROS parameter (see `param`)


class Param(NamedTuple):
    """A parameter of a configuration with its dotted name and its present value."""

    name: str
    value: Any
    spec: ParamSpec


def param(
    default: Any,
    description: str = '',
    *,
    limits: tuple[float, float] = (-inf, inf),
    choices: tuple[str, ...] = (),
    read_only: bool = True,
    expert: bool = False,
    internal: bool = False,
) -> Any:
    """Declare a parameter as a field of a `Config`.

    The default is a bool, int, float, str or tuple of strings, and values have the same type, but
    an int is accepted for a float. `ros2 param describe` and the reference page show the
    `description`: what the value does, its unit, and when to change it. A `read_only` parameter
    cannot change while the node runs, an `expert` one is declared only with `expert:=true`, and an
    `internal` one is set from Python and by profiles of experiments only; it has a comment in
    place of a description.
    """
    spec = ParamSpec(description, limits, choices, read_only, expert, internal)
    return field(default=default, metadata={_SPEC: spec})


def section(config: type[C], *, expert: bool = False) -> C:
    nested: C = field(default_factory=config, metadata={_EXPERT_SECTION: expert})
    return nested


@dataclass(frozen=True)
class Config:
    """Base of all configurations, whose constructor raises ConfigError for an invalid value."""

    def __post_init__(self) -> None:
        for f in fields(self):
            if _SPEC in f.metadata:
                name, value = f'{type(self).__name__}.{f.name}', getattr(self, f.name)
                checked = _checked(name, value, f.default, f.metadata[_SPEC])
                object.__setattr__(self, f.name, checked)

    def params(self, prefix: str = '') -> Iterator[Param]:
        for f in fields(self):
            value = getattr(self, f.name)
            if is_dataclass(value):
                inner = cast('Config', value).params(f'{prefix}{f.name}.')
                is_expert = f.metadata.get(_EXPERT_SECTION, False)
                for leaf in inner:
                    spec = replace(leaf.spec, expert=leaf.spec.expert or is_expert)
                    yield leaf._replace(spec=spec)
            else:
                yield Param(f'{prefix}{f.name}', value, f.metadata[_SPEC])

    def values(self) -> dict[str, Any]:
        return {leaf.name: leaf.value for leaf in self.params()}

    def node_params(self) -> Iterator[Param]:
        return (leaf for leaf in self.params() if not leaf.spec.is_internal)

    def updated(self, values: Mapping[str, Any]) -> Self:
        """Return a copy with new values by dotted name; ConfigError for a bad name or value."""
        known = {leaf.name: leaf for leaf in self.params()}
        for name, value in values.items():
            if name not in known:
                raise ConfigError(f'no parameter is called "{name}"{did_you_mean(name, known)}')
            # The value is checked here as well as in the constructor, so that the error names the
            # parameter with its section.
            _checked(name, value, known[name].value, known[name].spec)
        return _replaced(self, values)


def _replaced(config: C, values: Mapping[str, Any]) -> C:
    here: dict[str, Any] = {}
    nested: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        head, _, rest = name.partition('.')
        if rest:
            nested.setdefault(head, {})[rest] = value
        else:
            here[head] = value
    for head, inner in nested.items():
        here[head] = _replaced(getattr(config, head), inner)
    return replace(config, **here)


def _checked(name: str, value: Any, like: Any, spec: ParamSpec) -> Any:
    """Return a valid value; convert an int to a declared float, and `('',)` to `()`."""
    if type(value) is int and isinstance(like, float):
        value = float(value)  # YAML reads `3` as an int
    if value == ('',):
        value = ()  # ROS cannot represent an empty list of strings
    if not isinstance(value, type(like)) or isinstance(value, bool) != isinstance(like, bool):
        kind = 'list' if isinstance(like, tuple) else type(like).__name__  # YAML's name
        raise ConfigError(f'{name} must be {kind}, got {value!r}')
    if isinstance(value, tuple) and not all(isinstance(item, str) for item in value):
        raise ConfigError(f'{name} must be a list of strings, got {list(value)}')
    if spec.choices and value not in spec.choices:
        raise ConfigError(f'{name} must be one of {", ".join(spec.choices)}, got {value!r}')
    if isinstance(value, int | float) and not isinstance(value, bool):
        low, high = spec.limits
        if not low <= value <= high:  # also refuses NaN
            allowed = f'at least {low}' if high == inf else f'in [{low}, {high}]'
            raise ConfigError(f'{name} must be {allowed}, got {value}')
    return value


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the end of an error about an unknown name: '; did you mean ...?', or ''."""
    names = list(known)
    parts = [n for n in names if n.endswith(f'.{name}') or n.startswith(f'{name}.')]
    last = {n.rpartition('.')[2]: n for n in names}
    likely = (
        parts
        or get_close_matches(name, names, cutoff=_MIN_SIMILARITY)
        or [last[part] for part in get_close_matches(name, last, 1, _MIN_OF_BEST)]
    )
    return f'; did you mean {", ".join(likely[:_MAX_SUGGESTIONS])}?' if likely else ''
