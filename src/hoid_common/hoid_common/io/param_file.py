"""Reading of ROS parameter files without ROS, to check them before a node is started."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hoid_common.errors import ConfigError, InputError
from hoid_common.io.yaml_file import read_yaml


def load_params(path: Path, node_name: str) -> dict[str, Any]:
    """Return the parameters, by dotted name, that a parameter file sets for a node.

    Sections are `/**` and those of the node's name, in any namespace; a later one overrides an
    earlier one. Lists become tuples. ConfigError if the file is no parameter file.
    """
    try:
        content = read_yaml(path)
    except InputError as error:
        raise ConfigError(str(error)) from error
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
