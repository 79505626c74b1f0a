"""Configuration as frozen dataclasses: the one place of each default, description and range.

A stage's dataclass derives from `Config` and declares each field with `param(...)`. Nested configs
become dotted names (`extraction.num_features`), the same in Python, YAML and ROS parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass, replace
from typing import Any, NamedTuple, Self, cast

from hoid_common.errors import ConfigError

_SPEC = 'hoid_param'


@dataclass(frozen=True)
class ParamSpec:
    """What is said about a parameter beside its type and default."""

    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = True


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
) -> Any:
    """Declare a config field; `read_only=False` lets it change at run time."""
    spec = ParamSpec(description, minimum, maximum, choices, read_only)
    return field(default=default, metadata={_SPEC: spec})


@dataclass(frozen=True)
class Config:
    """Base of all configs: checks every value against its range on construction."""

    def __post_init__(self) -> None:
        for f in fields(self):
            if _SPEC not in f.metadata:
                continue
            value = getattr(self, f.name)
            if type(value) is int and isinstance(f.default, float):
                value = float(value)  # `3` in a YAML file
                object.__setattr__(self, f.name, value)
            _check(type(self).__name__, f, value)

    def params(self, prefix: str = '') -> Iterator[Param]:
        """Yield every leaf in order of declaration."""
        for f in fields(self):
            value = getattr(self, f.name)
            if is_dataclass(value):
                yield from cast('Config', value).params(f'{prefix}{f.name}.')
            else:
                yield Param(f'{prefix}{f.name}', value, f.metadata[_SPEC])

    def updated(self, values: Mapping[str, Any]) -> Self:
        """Return a copy with the dotted names replaced; an unknown one raises ConfigError."""
        here: dict[str, Any] = {}
        nested: dict[str, dict[str, Any]] = {}
        names = {f.name for f in fields(self)}
        for name, value in values.items():
            head, _, rest = name.partition('.')
            if head not in names:
                raise ConfigError(f'{type(self).__name__} has no parameter "{name}"')
            if rest:
                nested.setdefault(head, {})[rest] = value
            else:
                here[head] = value
        for head, inner in nested.items():
            here[head] = getattr(self, head).updated(inner)
        return replace(self, **here)


def _check(owner: str, f: Field[Any], value: Any) -> None:
    spec: ParamSpec = f.metadata[_SPEC]
    default = f.default if f.default is not MISSING else value
    if not isinstance(value, type(default)) or isinstance(value, bool) != isinstance(
        default, bool
    ):
        raise ConfigError(f'{owner}.{f.name} must be {type(default).__name__}, got {value!r}')
    if spec.choices and value not in spec.choices:
        raise ConfigError(
            f'{owner}.{f.name} must be one of {", ".join(spec.choices)}, got {value!r}'
        )
    if isinstance(value, int | float) and not isinstance(value, bool):
        low = spec.minimum is None or value >= spec.minimum
        high = spec.maximum is None or value <= spec.maximum
        if not (low and high):  # also refuses NaN
            raise ConfigError(
                f'{owner}.{f.name} must be in [{spec.minimum}, {spec.maximum}], got {value}'
            )
