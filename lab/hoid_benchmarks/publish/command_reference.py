"""Generator of the reference page of all commands from their parsers (`make reference`)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator

from hoid_bringup.arguments import help_text
from hoid_bringup.cli import COMMANDS, add_arguments

_HEAD = """# Commands

Written by `make reference` from the commands themselves. Every error is one line that names the
file, topic or parameter at fault, with exit status 1, or 2 for usage. `-v` says
more, `-q` less; both stand before or after the command. `eval "$(./hoid completion bash)"` (or
`zsh`) completes commands and options. Without a stated default there is none.
"""


def command_reference() -> str:
    """Return the page in Markdown, with a list of arguments for each command.

    An argument that several commands have is described at the first one.
    """
    parts = [_HEAD]
    described: dict[tuple[str, str], str] = {}  # by argument and help: the first command with it
    for name, command in COMMANDS.items():
        parser = argparse.ArgumentParser(prog=name, add_help=False)
        add_arguments(name, parser)
        parts.append(f'\n## hoid {name}\n\n{command.help[0].upper()}{command.help[1:]}.\n')
        rows, elsewhere = [], dict[str, list[str]]()
        for usage, text in _arguments(parser):
            first = described.setdefault((usage, text), name)
            if first == name or not usage.startswith('--'):
                rows.append(f'- `{usage}`: {text}')
            else:
                elsewhere.setdefault(first, []).append(f'`{usage.split()[0]}`')
        if rows:
            parts.append('\n'.join([*rows, '']))
        if elsewhere:
            links = (f'{", ".join(o)} as in [{n}](#hoid-{n})' for n, o in elsewhere.items())
            parts.append(f'Also {"; ".join(links)}.\n')
    return '\n'.join(parts)


def _arguments(parser: argparse.ArgumentParser) -> Iterator[tuple[str, str]]:
    """Yield the usage and the help of each argument, in Markdown."""
    for action in parser._actions:  # noqa: SLF001 - argparse has no public list of arguments
        if action.help != argparse.SUPPRESS:
            text = help_text(action) % {**vars(action), 'prog': parser.prog}
            text = text.removesuffix(' (default: none)')
            yield _usage(action), text


def _usage(action: argparse.Action) -> str:
    value = action.metavar or action.dest.upper()
    if action.choices is not None:
        value = '|'.join(map(str, action.choices))
    elif isinstance(value, tuple):
        value = ' '.join(value)
    if not action.option_strings:
        return value
    longest = max(action.option_strings, key=len)
    return longest if action.nargs == 0 else f'{longest} {value}'


if __name__ == '__main__':
    sys.stdout.write(command_reference())
