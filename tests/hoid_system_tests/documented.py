"""The commands in README and the documents, and the output shown for them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from textwrap import dedent
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / 'README.md', *sorted((ROOT / 'docs').rglob('*.md'))]
_BLOCK = re.compile(r'^ *```(\w*)\n(.*?)^ *```', re.DOTALL | re.MULTILINE)  # also in a list
_SHELL = ('', 'bash', 'sh', 'console')
_BEGINNING = re.compile(r'(\./hoid|make|ros2|python|colcon|source|export|sudo) ')
_INLINE = re.compile(r'`((?:\./hoid|make|ros2|python) [^`]+)`')
_COMMENT = re.compile(r'\s{3,}.*|\s+# .*|; ros2 .*')


class Shown(NamedTuple):
    """A command, and its output where the next block, a `text` one, or the next lines show it."""

    page: str
    command: str
    output: tuple[str, ...] = ()


def shown_commands(page: Path) -> Iterator[Shown]:
    """Yield the commands of a page in their order: those in blocks, then those within text."""
    name, text = str(page.relative_to(ROOT)), page.read_text(encoding='utf-8')
    found: list[Shown] = []
    for language, block in _BLOCK.findall(text):
        if language in _SHELL:
            found += _of_block(name, dedent(block).replace('\\\n', ' '))
        elif language == 'text' and found:
            found[-1] = found[-1]._replace(output=tuple(block.splitlines()))
    yield from found
    for command in _INLINE.findall(_BLOCK.sub('', text)):
        for part in command.split(';'):
            yield Shown(name, ' '.join(part.split()))


def shape(lines: Iterable[str]) -> list[str]:
    """Return lines with a mark for every number and path, and without their columns."""
    marked = (re.sub(r'\S*/\S+|-?\d[\d.]*', '#', line) for line in lines)
    return [' '.join(line.split()) for line in marked if line.strip()]


def _of_block(page: str, block: str) -> Iterator[Shown]:
    """Yield each command of a block; other lines are the output of the previous command."""
    command, output = '', list[str]()
    for line in block.splitlines():
        if _BEGINNING.match(line):
            if command:
                yield Shown(page, command, tuple(output))
            command, output = _COMMENT.sub('', line).strip(), []
        elif command and line.strip():
            output.append(line)
    if command:
        yield Shown(page, command, tuple(output))
