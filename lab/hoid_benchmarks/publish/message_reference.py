"""Generator of the reference page of all messages and services (`make reference`)."""

from __future__ import annotations

import re
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

_HEAD = """# Messages and services, field by field

Written by `make reference` from the files of `src/hoid_msgs`. Every response also has
`bool success` and `string message`, which is the result, or the error and what to do about it.
`NAME=VALUE` is a constant.
"""
_IN_EVERY_RESPONSE = re.compile(r'^(?:bool success|string message) .*\n?', re.MULTILINE)
_WIDTH = 110  # characters in a line of the page
_FIELD = re.compile(r'(?P<type>\S+)\s+(?P<name>\w+)(?:=(?P<value>\S+))?\s*(?:#\s*(?P<text>.*))?$')


def message_reference(package: Path) -> str:
    """Return the page in Markdown, with the fields of each message and service of a package."""
    parts = [_HEAD]
    for path in sorted(package.glob('*/*.[ms][sr][gv]')):
        description, *lists = _read(path.read_text(encoding='utf-8'))
        parts.append(f'## {path.stem}\n\n{description}\n')
        for title, fields in zip(('', 'Response:\n\n'), lists, strict=False):
            parts += [f'{title}{fields}\n'] if fields else []
    return '\n'.join(parts)


def _read(text: str) -> Iterator[str]:
    """Yield the description of an interface, then the list of the fields of each part.

    A message has one part; a service has two: request and response.
    """
    description, _, rest = text.partition('\n\n')
    yield textwrap.fill(' '.join(line.lstrip('# ') for line in description.splitlines()), _WIDTH)
    request, *response = rest.split('\n---\n')
    for part in (request, *(_IN_EVERY_RESPONSE.sub('', text) for text in response)):
        yield '\n'.join(_items(part.strip().splitlines()))


def _items(lines: list[str]) -> Iterator[str]:
    """Yield the list item of each field, and each comment between fields as a paragraph."""
    item = ''
    for line in filter(None, lines):
        if line.lstrip().startswith('#') and item[:2] == '- ' and not line.startswith('#'):
            item += f' {line.lstrip(" #")}'  # the comment of a field continues
            continue
        yield from filter(None, [item])
        item = f'\n{line.lstrip("# ")}\n' if line.startswith('#') else _field(line)
    yield item


def _field(line: str) -> str:
    """Return the list item of a field; raise ValueError if it is no field."""
    found = _FIELD.match(line)
    if found is None:
        raise ValueError(f'is no field of a message: {line}')
    name, value = found['name'], found['value']
    text = f': {found["text"]}' if found['text'] else ''
    what = f'{name}={value}' if value else f'{found["type"]} {name}'
    return f'- `{what}`{text}'


if __name__ == '__main__':
    sys.stdout.write(message_reference(Path(sys.argv[1])))
