"""The command line `hoid`.

The module of a command is imported only when the command is given, so that `hoid --help` and short
commands start at once.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

from hoid_bags.progress import AboveProgress, write_above
from hoid_bringup.arguments import Parser
from hoid_common.config import did_you_mean
from hoid_common.errors import HoidError, InputError
from hoid_common.io.files import abandoned_scratch_folders
from hoid_common.io.untrusted import check_path_name
from hoid_common.process.limits import require_memory
from hoid_common.process.output import relay_output
from hoid_common.process.signals import interrupt_on_termination, termination_signals_blocked

_OK, _FAILED, _INTERRUPTED = 0, 1, 130
_NODES = 'nodes'
_SERVICES = 'hoid_bringup.live.node_services'
_LEVELS = {'verbose': logging.DEBUG, '': logging.WARNING, 'quiet': logging.ERROR}
_FREE_TEXT = ('set',)  # options whose values are not file names
# Environment variables with the number of threads of numerical libraries.
_THREAD_VARIABLES = ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS')


@dataclass(frozen=True)
class Command:
    """A sub-command of `hoid`.

    Its module has the functions `add_<name>_arguments(parser)` and `<name>_command(args)`, where
    underscores replace hyphens of the name.
    """

    module: str
    help: str  # what the command does, in a few words
    # Whether the command handles images in real time, so that it must not wait until somebody
    # reads its stdout or stderr (a full pipe, a stopped terminal). Another process then relays its
    # output; output to a terminal is relayed for `nodes` only.
    is_live: bool = False


COMMANDS = {
    'demo': Command(
        'hoid_benchmarks.demo',
        'compare SLAM with and without the filter, on a rendered scene or a camera',
    ),
    'convert': Command(
        'hoid_bags.commands', 'convert a recording in files or a ROS 1 bag to an MCAP bag'
    ),
    'synth': Command('hoid_synth.commands', 'render a bag of a scene with moving people'),
    'info': Command('hoid_bags.commands', 'list the topics of a bag, or repair it'),
    'play': Command('hoid_bags.commands', 'publish the messages of a bag', is_live=True),
    'record': Command('hoid_bags.commands', 'record topics into a bag', is_live=True),
    _NODES: Command(
        'hoid_bringup.live.nodes', 'run detector, filter and SLAM nodes on a robot', is_live=True
    ),
    'status': Command(_SERVICES, 'print the state of the running nodes'),
    'save-map': Command(_SERVICES, 'have the running nodes save their map'),
    'load-map': Command(_SERVICES, 'have the running nodes load a saved map'),
    'set-mode': Command(_SERVICES, 'switch the running nodes to mapping or to localization'),
    'run': Command('hoid_bringup.commands', 'run SLAM on every frame of a recording, offline'),
    'replay': Command(
        'hoid_bringup.commands', 'play a recording in real time to the nodes', is_live=True
    ),
    'map': Command('hoid_bringup.maps.map_command', 'describe saved maps, or join several'),
    'objects': Command('hoid_bringup.maps.objects_command', 'list the objects of a saved map'),
    'evaluate': Command('hoid_bringup.commands', 'compute the errors of a trajectory'),
    'bench': Command('hoid_benchmarks.commands', 'run experiments, or measure a stage'),
    'view': Command('hoid_bringup.view.view', 'show a recording or the results of a run in 3-D'),
    'completion': Command(
        'hoid_bringup.cli', 'print the script that completes this command line in a shell'
    ),
    'pictures': Command('hoid_benchmarks.pictures', 'draw the verdicts of the filter on images'),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status.

    The status is 0 after success, or if the reader of stdout has ended; 1 after a HoidError or an
    OSError, which is printed in one line; 130 after an interrupt. SystemExit with status 2 if the
    usage is wrong, and with status 0 after help.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    chosen = _command_in(argv)
    try:
        # Threads only cost time, because the matrices are small.
        for variable in _THREAD_VARIABLES:
            os.environ.setdefault(variable, '1')
        interrupt_on_termination()
        return _run_command(chosen, argv)
    except KeyboardInterrupt:  # also if the interrupt comes while an error is printed
        sys.stderr.write(f'hoid {chosen}: interrupted\n')
        return _INTERRUPTED


def _run_command(chosen: str, argv: Sequence[str]) -> int:
    try:
        if '_ARGCOMPLETE' in os.environ:
            chosen = _command_in(os.environ.get('COMP_LINE', '').split()[1:])
            complete(argument_parser(chosen if chosen in COMMANDS else ''))  # ends the process
        # Called before a module of the command imports NumPy, which fails without memory by an
        # error that does not name the limit.
        require_memory()
        args = argument_parser(chosen).parse_args(argv)
        if COMMANDS[chosen].is_live:
            # Output of `nodes` is relayed even to a terminal, because `nodes` must not wait if the
            # terminal is stopped. The other commands draw progress bars, which need the terminal
            # itself.
            relay_output(terminals=chosen == _NODES)
        handler = AboveProgress()
        handler.addFilter(_is_own_or_warning)
        logging.basicConfig(
            level=_LEVELS[args.verbosity],
            format='%(levelname)s %(name)s: %(message)s',
            handlers=[handler],
        )
        _check_names(args)
        for line in _abandoned_folders(args):
            sys.stderr.write(f'hoid: {line}\n')
        getattr(_module(chosen), f'{_identifier(chosen)}_command')(args)
        print(end='', flush=True)  # writing the buffered output may fail
    except HoidError as error:
        logging.getLogger(__name__).debug('failed', exc_info=True)
        with suppress(KeyboardInterrupt):  # nothing is left to interrupt
            write_above(f'hoid {chosen}: {error}')
        return _FAILED
    except BrokenPipeError:  # as in `hoid info BAG | head`
        _discard_stdout()
        return _OK
    # For example, the disk of stdout is full, or the working folder was removed.
    except OSError as error:
        logging.getLogger(__name__).debug('failed', exc_info=True)
        sys.stderr.write(f'hoid {chosen}: {InputError(error)}\n')
        _discard_stdout()
        return _FAILED
    return _OK


def _is_own_or_warning(record: logging.LogRecord) -> bool:
    """Return whether a log record is from the suite, or from a library and at least a warning."""
    return record.levelno >= logging.WARNING or record.name.startswith(('hoid_', 'rgbd_slam'))


def _command_in(words: Sequence[str]) -> str:
    return next((word for word in words if not word.startswith('-')), '')


def _discard_stdout() -> None:
    """Discard buffered output, which would raise another error when the interpreter exits."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def _check_names(args: argparse.Namespace) -> None:
    """Raise ConfigError, before any work begins, for an argument that cannot be a path or name."""
    for option, value in vars(args).items():
        name = option.replace('_', '-')
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, Path):
                check_path_name(str(item), name)
                check_path_name(os.path.realpath(item), name)
            elif isinstance(item, str) and item and option not in _FREE_TEXT:
                check_path_name(item, name)


def _abandoned_folders(args: argparse.Namespace) -> Iterator[str]:
    """Yield a warning for each hidden folder that a killed command has left behind.

    It searches the folders that arguments name, and the parent folders of paths, but not lists of
    paths.
    """
    paths = {value for value in vars(args).values() if isinstance(value, Path)}
    for folder in sorted({path.parent for path in paths} | {p for p in paths if p.is_dir()}):
        for left in abandoned_scratch_folders(folder):
            if left not in paths and any(left.glob('*/*.mcap')):
                yield f'{left}: left by a killed recording; "hoid info --repair" restores the bag'
            elif left not in paths:
                yield f'{left}: left by a killed command; it can be removed'


def argument_parser(chosen: str) -> argparse.ArgumentParser:
    """Return the parser of all commands, with the arguments of the chosen command only.

    The command's module is imported; InputError if a Python package that it needs is missing.
    """
    parser = Parser(prog='hoid', description='RGB-D SLAM among moving people.')
    parser.add_argument('--version', action='version', version=f'hoid {version("hoid_bringup")}')
    _add_verbosity(parser, '')
    commands = parser.add_subparsers(dest='command', required=True, metavar='COMMAND')
    for name, command in COMMANDS.items():
        sub = commands.add_parser(name, help=command.help, description=f'{command.help}.')
        if name == chosen:
            add_arguments(name, sub)
            # Keeps an option that is given before the command.
            _add_verbosity(sub, argparse.SUPPRESS)
    if chosen and chosen not in COMMANDS:
        parser.error(f'there is no command {chosen}{did_you_mean(chosen, COMMANDS)}')
    return parser


def complete(parser: argparse.ArgumentParser) -> None:
    """Print the possible next words for the shell's completion, and end the process."""
    import argcomplete  # part of ROS's pip wheels and installations

    argcomplete.autocomplete(parser)


def add_completion_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('shell', choices=('bash', 'zsh'), help='the shell that completes')


def completion_command(args: argparse.Namespace) -> None:
    from argcomplete.shell_integration import shellcode

    print(shellcode(['hoid'], shell=args.shell))


def _add_verbosity(parser: argparse.ArgumentParser, default: str) -> None:
    for name, what in (
        ('verbose', 'show log messages and tracebacks'),
        ('quiet', 'show neither warnings nor progress'),
    ):
        parser.add_argument(
            f'-{name[0]}', f'--{name}', dest='verbosity', action='store_const', const=name,
            default=default, help=what
        )  # fmt: skip


def add_arguments(command: str, parser: argparse.ArgumentParser) -> None:
    getattr(_module(command), f'add_{_identifier(command)}_arguments')(parser)


def _identifier(command: str) -> str:
    return command.replace('-', '_')


def _module(command: str) -> ModuleType:
    """Import the module of a command; InputError if a Python package that it needs is missing."""
    try:
        with termination_signals_blocked():  # an import may swallow a KeyboardInterrupt
            return import_module(COMMANDS[command].module)
    except ModuleNotFoundError as error:
        raise InputError(
            f'the Python package {error.name} is missing: run the command through ./hoid, '
            'or "pip install -r requirements/experiments.lock"'
        ) from error
