"""Configuration as frozen dataclasses: the one place of each default, description and range.

A stage's dataclass derives from `Config` and declares each field with `param(...)`, or with
`section(...)` where it is a config itself: nested names are dotted (`extraction.num_features`),
the same in Python, YAML and ROS.

Constants of a method that nobody needs to set stand beside its parameters as class variables.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from difflib import get_close_matches
from typing import Any, NamedTuple, Self, TypeVar, cast

from hoid_common.errors import ConfigError

C = TypeVar('C', bound='Config')

EXPERT = 'expert'
"""The switch of a node that declares its expert parameters."""

_SPEC, _EXPERT_SECTION = 'hoid_param', 'hoid_expert'
_ALIKE = 0.8  # of difflib's ratios: a letter or two
_MOST_MEANT = 3  # names that are offered for an unknown one


@dataclass(frozen=True)
class ParamSpec:
    """What is said about a parameter beside its type and default."""

    description: str  # whole sentences, with the unit of a number
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = True
    expert: bool = False  # a node declares it only when it is started with `expert:=true`


class Param(NamedTuple):
    """One leaf of a configuration: its dotted name, value and spec."""

    name: str
    value: Any
    spec: ParamSpec


def param(
    default: Any,
    description: str,
    *,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
    read_only: bool = True,
    expert: bool = False,
) -> Any:
    """Declare a config field.

    Args:
        default: Its type is the field's: bool, int, float, str, or a tuple of strings.
        description: For people, such as those who ask `ros2 param describe`: sentences that say
            what it does, the unit, and of a user parameter when to change it.
        minimum: Least value of a number.
        maximum: Greatest value of a number.
        choices: The only values of a string.
        read_only: False lets it change at run time.
        expert: It is for those who know the method, and hidden from others.
    """
    spec = ParamSpec(description, minimum, maximum, choices, read_only, expert)
    return field(default=default, metadata={_SPEC: spec})


def section(config: type[C], *, expert: bool = False) -> C:
    """Declare a nested config; all parameters of an expert one are for experts."""
    nested: C = field(default_factory=config, metadata={_EXPERT_SECTION: expert})
    return nested


@dataclass(frozen=True)
class Config:
    """Base of all configs: checks every value against its range on construction."""

    def __post_init__(self) -> None:
        for f in fields(self):
            if _SPEC in f.metadata:
                name, value = f'{type(self).__name__}.{f.name}', getattr(self, f.name)
                checked = _checked(name, value, f.default, f.metadata[_SPEC])
                object.__setattr__(self, f.name, checked)

    def params(self, prefix: str = '') -> Iterator[Param]:
        """Yield every leaf in order of declaration."""
        for f in fields(self):
            value = getattr(self, f.name)
            if is_dataclass(value):
                inner = cast('Config', value).params(f'{prefix}{f.name}.')
                is_expert = f.metadata.get(_EXPERT_SECTION, False)
                yield from map(_for_experts, inner) if is_expert else inner
            else:
                yield Param(f'{prefix}{f.name}', value, f.metadata[_SPEC])

    def updated(self, values: Mapping[str, Any]) -> Self:
        """Return a copy with the values of dotted names replaced.

        Raises:
            ConfigError: A name is unknown, or a value of another type or out of range.
        """
        known = {leaf.name: leaf for leaf in self.params()}
        for name, value in values.items():
            if name not in known:
                raise ConfigError(f'no parameter is called "{name}"{did_you_mean(name, known)}')
            _checked(name, value, known[name].value, known[name].spec)  # by its whole name
        return _replaced(self, values)


def _for_experts(leaf: Param) -> Param:
    return leaf._replace(spec=replace(leaf.spec, expert=True))


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
    """Return a value of the type of another and within its range.

    Raises:
        ConfigError: It is of another type or out of range; the name is said as given.
    """
    if type(value) is int and isinstance(like, float):
        value = float(value)  # `3` in a YAML file
    if value == ('',):
        value = ()  # ROS knows no empty list of strings
    if not isinstance(value, type(like)) or isinstance(value, bool) != isinstance(like, bool):
        kind = 'list' if isinstance(like, tuple) else type(like).__name__  # as in a YAML file
        raise ConfigError(f'{name} must be {kind}, got {value!r}')
    if isinstance(value, tuple) and not all(isinstance(item, str) for item in value):
        raise ConfigError(f'{name} must be a list of strings, got {list(value)}')
    if spec.choices and value not in spec.choices:
        raise ConfigError(f'{name} must be one of {", ".join(spec.choices)}, got {value!r}')
    if isinstance(value, int | float) and not isinstance(value, bool):
        high_enough = spec.minimum is None or value >= spec.minimum
        low_enough = spec.maximum is None or value <= spec.maximum
        if not (high_enough and low_enough):  # also refuses NaN
            raise ConfigError(f'{name} must be {_range(spec)}, got {value}')
    return value


def _range(spec: ParamSpec) -> str:
    if spec.maximum is None:
        return f'at least {spec.minimum}'
    return (
        f'at most {spec.maximum}'
        if spec.minimum is None
        else f'in [{spec.minimum}, {spec.maximum}]'
    )


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return which known names an unknown one may stand for, as the end of a complaint."""
    names = list(known)
    parts = [n for n in names if n.endswith(f'.{name}') or n.startswith(f'{name}.')]
    likely = parts or get_close_matches(name, names, cutoff=_ALIKE)
    return f'; did you mean {", ".join(likely[:_MOST_MEANT])}?' if likely else ''
