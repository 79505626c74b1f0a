"""Parser of the command line, whose errors suggest similar options."""

from __future__ import annotations

import argparse
import re
import sys
from typing import Any, NoReturn

from hoid_common.config import did_you_mean

_CHOICE = re.compile(r"invalid choice: '?([^']*?)'? \(choose from (.*)\)")


class Parser(argparse.ArgumentParser):
    """A parser whose errors print one line with a suggestion before the usage."""

    def __init__(self, *, prog: str, **options: Any) -> None:
        # Abbreviations are off, so that a new option cannot change the meaning of an old command
        # line.
        options |= {'formatter_class': _Formatter, 'allow_abbrev': False}
        super().__init__(prog=prog, **options)

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the arguments; an error about an unknown one suggests a similar option."""
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            command = self.of_command(getattr(found, 'command', ''))
            command.error(f'unknown: {" ".join(unknown)}{command.suggested_option(unknown[0])}')
        return found

    def of_command(self, name: str) -> Parser:
        """Return the parser of a sub-command, or this one if there is no such sub-command."""
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 - no public name
                found: Parser = action.choices.get(name, self)
                return found
        return self

    def suggested_option(self, word: str) -> str:
        """Return the end of an error line: '; did you mean ...?' with a similar option, or ''."""
        name = word.partition('=')[0]
        return did_you_mean(name, self._option_string_actions)

    def error(self, message: str) -> NoReturn:
        """Print the error before the usage, and exit with status 2."""
        if found := _CHOICE.search(message):
            message += did_you_mean(found[1], [c.strip(" '") for c in found[2].split(',')])
        sys.stderr.write(f'{self.prog}: {message}; see "./{self.prog} --help"\n')
        self.print_usage(sys.stderr)
        sys.exit(2)


class _Formatter(argparse.HelpFormatter):
    def _get_help_string(self, action: argparse.Action) -> str:
        return help_text(action)


def help_text(action: argparse.Action) -> str:
    """Return the help text of an argument, as a format string, with its default value appended."""
    text = action.help or ''
    takes_value = action.option_strings and action.nargs != 0 and not action.required
    if not takes_value or '(default' in text:
        return text
    is_none = action.default is None or action.default in ('', [], argparse.SUPPRESS)
    return f'{text} (default: {"none" if is_none else "%(default)s"})'
