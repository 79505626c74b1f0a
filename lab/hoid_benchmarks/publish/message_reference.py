"""Generator of the reference page of all messages and services (`make reference`)."""

from __future__ import annotations

import re
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

_HEAD = """# Messages and services, field by field

Written by `make reference` from the files of `src/hoid_msgs`.
"""
_WIDTH = 110  # characters in a line of the page
_FIELD = re.compile(r'(?P<type>\S+)\s+(?P<name>\w+)(?:=(?P<value>\S+))?\s*(?:#\s*(?P<text>.*))?$')


def message_reference(package: Path) -> str:
    """Return the page in Markdown, with the fields of each message and service of a package."""
    parts = [_HEAD]
    for path in sorted(package.glob('*/*.[ms][sr][gv]')):
        description, *tables = _read(path.read_text(encoding='utf-8'))
        parts.append(f'## {path.stem}\n\n{description}\n')
        for title, table in zip(('field', 'answer'), tables, strict=False):
            parts.append(f'| {title} | what it is |\n|---|---|\n{table}\n')
    return '\n'.join(parts)


def _read(text: str) -> Iterator[str]:
    """Yield the description of an interface, then the table rows of each part as one text.

    A message has one part; a service has two: request and response.
    """
    description, _, rest = text.partition('\n\n')
    yield textwrap.fill(' '.join(line.lstrip('# ') for line in description.splitlines()), _WIDTH)
    for part in rest.split('\n---\n'):
        yield '\n'.join(_rows(part.strip().splitlines()))


def _rows(lines: list[str]) -> Iterator[str]:
    """Yield the table row of each field and of each comment between fields."""
    cells: list[str] = []
    for line in filter(None, lines):
        if line.startswith('#') or not cells:  # a comment on the fields that follow
            yield from _row(cells)
            cells = ['', line.lstrip('# ')] if line.startswith('#') else _cells(line)
        elif line.lstrip().startswith('#'):  # the comment of a field continues
            cells[-1] += f' {line.lstrip(" #")}'
        else:
            yield from _row(cells)
            cells = _cells(line)
    yield from _row(cells)


def _cells(line: str) -> list[str]:
    """Return type and name, and the comment of a field; raise ValueError if it is no field."""
    found = _FIELD.match(line)
    if found is None:
        raise ValueError(f'is no field of a message: {line}')
    value = f' = {found["value"]}' if found['value'] else ''
    return [f'`{found["type"]} {found["name"]}{value}`', found['text'] or '']


def _row(cells: list[str]) -> Iterator[str]:
    if cells:
        yield f'| {" | ".join(cell.replace("|", chr(92) + "|") for cell in cells)} |'


if __name__ == '__main__':
    sys.stdout.write(message_reference(Path(sys.argv[1])))
