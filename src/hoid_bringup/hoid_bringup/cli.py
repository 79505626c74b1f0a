"""`hoid`: one command line for the whole suite.

Each command's code is imported only when it is chosen, so that `hoid --help` and short commands
start at once.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType

from hoid_common.errors import HoidError, InputError
from hoid_common.io.files import abandoned_scratch_folders
from hoid_common.io.untrusted import check_path_name
from hoid_common.process.signals import interrupt_on_termination, termination_signals_blocked

_OK, _FAILED, _INTERRUPTED = 0, 1, 130
_NO_NAMES = ('set',)  # options whose text is of any length
_THREAD_VARIABLES = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS')


@dataclass(frozen=True)
class Command:
    """A sub-command; its module has `add_<name>_arguments(parser)` and `<name>_command(args)`."""

    module: str
    help: str


COMMANDS = {
    'demo': Command(
        'hoid_benchmarks.demo', 'show a rendered scene or a camera with and without the filter'
    ),
    'convert': Command('hoid_bags.commands', 'turn a TUM folder into an MCAP bag'),
    'synth': Command('hoid_synth.commands', 'render a scene with people into a bag'),
    'info': Command('hoid_bags.commands', "list a bag's topics"),
    'play': Command('hoid_bags.commands', 'play a bag on topics'),
    'record': Command('hoid_bags.commands', 'record topics into a bag'),
    'nodes': Command('hoid_bringup.live.nodes', 'run the three nodes for a live robot'),
    'run': Command('hoid_bringup.commands', 'process a recording offline, every frame'),
    'replay': Command('hoid_bringup.commands', 'play a recording through the live nodes'),
    'evaluate': Command('hoid_bringup.commands', 'compare a trajectory with the truth'),
    'bench': Command('hoid_benchmarks.commands', 'measure: speed of a stage, or all experiments'),
    'view': Command('hoid_bringup.view.view', 'look at a recording or a finished run'),
    'pictures': Command('hoid_bringup.view.pictures', 'draw what the filter sees and decides'),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line and return its status: 1 for an error said in one line, 2 for usage."""
    for variable in _THREAD_VARIABLES:  # small matrices: more threads only cost
        os.environ.setdefault(variable, '1')
    interrupt_on_termination()
    argv = list(sys.argv[1:] if argv is None else argv)
    chosen = next((word for word in argv if not word.startswith('-')), '')
    try:
        args = _parser(chosen).parse_args(argv)
        logging.basicConfig(
            level=logging.DEBUG if args.verbose else logging.WARNING,
            format='%(levelname)s %(name)s: %(message)s',
        )
        _check_names(args)
        for line in _leftovers(args):
            sys.stderr.write(f'hoid: {line}\n')
        getattr(_module(chosen), f'{chosen}_command')(args)
        print(end='', flush=True)  # what has not gone out yet may fail to
    except HoidError as error:
        logging.getLogger(__name__).debug('failed', exc_info=True)
        sys.stderr.write(f'hoid {chosen}: {error}\n')
        return _FAILED
    except KeyboardInterrupt:
        sys.stderr.write(f'hoid {chosen}: interrupted\n')
        return _INTERRUPTED
    except BrokenPipeError:  # `hoid info BAG | head`
        _say_no_more()
        return _OK
    except OSError as error:  # a full disk behind stdout, a working folder that is gone
        logging.getLogger(__name__).debug('failed', exc_info=True)
        sys.stderr.write(f'hoid {chosen}: {InputError(error)}\n')
        _say_no_more()
        return _FAILED
    return _OK


def _say_no_more() -> None:
    """Let nothing that still waits for stdout fail at the end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def _check_names(args: argparse.Namespace) -> None:
    """Raise ConfigError for a name that no file can have, before any work begins."""
    for option, value in vars(args).items():
        what = option.replace('_', '-')
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, Path):
                check_path_name(str(item), what)
                check_path_name(os.path.realpath(item), what)
            elif isinstance(item, str) and item and option not in _NO_NAMES:
                check_path_name(item, what)


def _leftovers(args: argparse.Namespace) -> Iterator[str]:
    """Yield what is said of hidden folders that killed commands left beside the files named."""
    paths = {value for value in vars(args).values() if isinstance(value, Path)}
    for folder in sorted({path.parent for path in paths} | {p for p in paths if p.is_dir()}):
        for left in abandoned_scratch_folders(folder):
            if left not in paths and any(left.glob('*/*.mcap')):
                yield f'{left}: left by a killed recording; "hoid info --repair" makes a bag of it'
            elif left not in paths:
                yield f'{left}: left by a killed command; it can be removed'


def _parser(chosen: str) -> argparse.ArgumentParser:
    """Build the parser; only the chosen command gets its arguments, which needs its module."""
    parser = argparse.ArgumentParser(prog='hoid', description='RGB-D SLAM among moving people.')
    parser.add_argument('-v', '--verbose', action='store_true', help='say more, with tracebacks')
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    for name, command in COMMANDS.items():
        # Half an option's name must not choose another one.
        sub = commands.add_parser(
            name, help=command.help, description=f'{command.help}.', allow_abbrev=False
        )
        if name == chosen:
            add_arguments(name, sub)
    return parser


def add_arguments(command: str, parser: argparse.ArgumentParser) -> None:
    """Declare a command's arguments; raise InputError where a package that it needs is missing."""
    getattr(_module(command), f'add_{command}_arguments')(parser)


def _module(command: str) -> ModuleType:
    """Import a command's code; raise InputError where a package that it needs is missing."""
    try:
        with termination_signals_blocked():  # an import may swallow it
            return import_module(COMMANDS[command].module)
    except ModuleNotFoundError as error:
        raise InputError(
            f'the Python package {error.name} is missing: start the command by ./hoid, '
            'or "pip install -r requirements/experiments.lock"'
        ) from error
