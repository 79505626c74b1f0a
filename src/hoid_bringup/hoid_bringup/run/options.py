"""Options that `run`, `replay` and the experiments share, and the configuration they make."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.convert import ConvertConfig, convert
from hoid_bags.options import add_folder_arguments, chosen_camera
from hoid_bags.sequence import Sequence, open_sequence
from hoid_bringup.run.run_config import SHORT_NAMES, TRUTH, RunConfig
from hoid_common.errors import ConfigError, InputError
from hoid_common.io.files import scratch_folder
from hoid_common.io.yaml_file import parse_yaml
from hoid_filter.strategy_registry import STRATEGIES

_SHORTCUTS = {
    **SHORT_NAMES,
    'detector': 'detector.model',
    'min_interaction_area': 'filter.min_interaction_area',
    'depth_limit': 'filter.depth_limit_m',
}


def add_recording_arguments(
    parser: argparse.ArgumentParser, what: str = 'TUM folder or bag'
) -> None:
    """Add the recording and how to read it."""
    parser.add_argument('input', metavar='INPUT', type=Path, help=what)
    add_folder_arguments(parser)


def add_method_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the choice of filter and detector and every other parameter."""
    parser.add_argument('--filter', choices=STRATEGIES, help='how dynamic objects are told')
    parser.add_argument(
        '--detector',
        metavar='MODEL',
        help=f'ONNX file; "{TRUTH}": the exact boxes of a rendered bag (default: usual places)',
    )
    parser.add_argument('--min-interaction-area', type=float, metavar='A', help='share in [0, 1]')
    parser.add_argument('--depth-limit', type=float, metavar='M', help='m, of the 3-D rule')
    parser.add_argument('--seed', type=int, metavar='N', help='of everything random')
    add_set_argument(parser)


def add_set_argument(parser: argparse.ArgumentParser) -> None:
    """Add the option for any parameter of any node."""
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='any parameter, also for experts, by its name or NODE.name, such as '
        'extraction.num_features=500 or slam.seed=1',
    )


def recording(args: argparse.Namespace) -> Sequence:
    """Open the recording that the options name.

    Raises:
        InputError: It cannot be used.
    """
    return open_sequence(args.input, chosen_camera(args), args.depth_factor)


@contextmanager
def playable_bag(args: argparse.Namespace) -> Iterator[BagSequence]:
    """Give the recording as a bag; one made from a folder goes away at the end.

    Raises:
        InputError: It cannot be used.
    """
    found = recording(args)
    if isinstance(found, BagSequence):
        yield found
        return
    with scratch_folder(args.out, 'bag') as folder:
        path = folder / args.input.resolve().name
        config = ConvertConfig(depth_units_per_m=args.depth_factor)
        convert(args.input, path, config, found.camera, show_progress=True)
        yield BagSequence(path)


def run_config(args: argparse.Namespace, base: RunConfig | None = None) -> RunConfig:
    """Return the configuration that the options make.

    Args:
        base: What holds where no option is given; the defaults when None.

    Raises:
        ConfigError: A name is unknown or a value out of range.
    """
    return (base or RunConfig()).updated(asked_for(args))


def asked_for(args: argparse.Namespace) -> dict[str, Any]:
    """Return the parameters that the options set, by dotted name.

    Raises:
        ConfigError: One is no assignment.
    """
    values: dict[str, Any] = {
        name: getattr(args, option)
        for option, name in _SHORTCUTS.items()
        if getattr(args, option) is not None
    }
    values |= assignments(args.set)
    return values


def assignments(texts: Iterable[str]) -> dict[str, Any]:
    """Return names and values of what `--set` was given.

    Raises:
        ConfigError: One is not NAME=VALUE.
    """
    return dict(_assignment(text) for text in texts)


def _assignment(text: str) -> tuple[str, Any]:
    """Return name and value of `name=value`; the value is read as YAML, as in a parameter file."""
    name, sign, value_text = text.partition('=')
    if not sign:
        raise ConfigError(f'--set {text}: expected NAME=VALUE')
    try:
        value = parse_yaml(value_text, f'--set {name}')
    except InputError as error:
        raise ConfigError(str(error)) from error
    return name, tuple(value) if isinstance(value, list) else value
