"""Class names of a model, from a file or from the model's metadata."""

from __future__ import annotations

import ast
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from hoid_common.errors import InputError, ModelError, prefixed
from hoid_common.io.untrusted import expand_home, read_text
from hoid_common.io.yaml_file import parse_yaml
from hoid_common.values import PERSON

_MAX_FILE_BYTES = 1_000_000  # chosen: far above any list of class names
# Keys under which exporters store class names; Ultralytics writes `names`.
_METADATA_KEYS = ('names', 'class_names', 'classes', 'labels', 'id2label', 'label2id')

# Lower-case names of class 0 in data sets where that class means "no object".
_BACKGROUND = ('background', '__background__', 'bg', 'n/a', '???', 'none', 'unlabeled', 'void')


def known_names(file: str, metadata: Mapping[str, str]) -> tuple[str, ...] | None:
    """Return the class names in a file or else in the metadata, or None."""
    if not file:
        return names_in_metadata(metadata)
    return names_in_file(expand_home(file, 'class_names_file'))


def with_person(names: Sequence[str], person_names: Collection[str]) -> tuple[str, ...]:
    """Return the names with each synonym replaced by `person`; ModelError if none is a synonym."""
    synonyms = {name.casefold() for name in person_names}
    found = tuple(PERSON if name.strip().casefold() in synonyms else name for name in names)
    if synonyms and PERSON not in found:
        raise ModelError(
            f'no class is called {" or ".join(person_names)}; the classes are {", ".join(names)}: '
            'name the class of people with person_names, or use a model that finds people'
        )
    return found


def is_background(name: str) -> bool:
    return name.strip().casefold() in _BACKGROUND


def names_in_file(path: Path) -> tuple[str, ...]:
    """Return the names in a text file with one name per line; ModelError if it is unusable."""
    with prefixed('class_names_file ', ModelError, InputError):
        text = read_text(path, _MAX_FILE_BYTES)
    names = tuple(line.strip() for line in text.rstrip().splitlines())
    if not names:
        raise ModelError(f'class_names_file {path} is empty: write one class name a line')
    if '' in names:
        raise ModelError(
            f'class_names_file {path}: line {names.index("") + 1} is empty, which would shift the '
            'classes: write a name there, also for a class that is not used'
        )
    return names


def names_in_metadata(metadata: Mapping[str, str]) -> tuple[str, ...] | None:
    """Return the class names in a model's metadata; None if it has none."""
    for key in _METADATA_KEYS:
        if text := metadata.get(key):
            return _parse(key, text)
    return None


def _parse(key: str, text: str) -> tuple[str, ...]:
    value = _literal(text)
    if isinstance(value, dict):
        # Names by index are expected; {'person': 0} is the reverse.
        if all(type(index) is int for index in value.values()):
            value = {index: name for name, index in value.items()}
        by_index = {str(index): name for index, name in value.items()}
        if by_index.keys() != {str(index) for index in range(len(value))}:
            raise ModelError(f'model metadata "{key}": class indices {[*value]} have gaps')
        value = [by_index[str(index)] for index in range(len(value))]
    if not isinstance(value, list | tuple) or not value:
        raise ModelError(f'model metadata "{key}" is no list of class names: {text[:60]!r}')
    return tuple(str(name) for name in value)


def _literal(text: str) -> object:
    """Return the value of a Python, JSON or YAML literal, else the comma-separated parts."""
    try:
        return ast.literal_eval(text)
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        pass
    try:
        value = parse_yaml(text, 'names')
    except InputError:
        value = text
    if isinstance(value, dict | list):
        return value
    return [name.strip() for name in re.split(r'[,;\n]', text) if name.strip()]
