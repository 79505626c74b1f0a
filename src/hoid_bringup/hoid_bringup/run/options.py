"""Command-line options that several commands share, and the configuration that they set."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.bag.bag_topics import TopicChoice
from hoid_bags.bag.repair import copy_bag
from hoid_bags.convert import ConvertConfig, convert
from hoid_bags.options import (
    chosen_topics,
    depth_offset_ns,
    depth_units_per_m,
    open_recording,
)
from hoid_bags.sequence import Sequence
from hoid_bags.tum.association import MAX_PAIR_GAP_NS
from hoid_bringup.run.no_detector import MOTION
from hoid_bringup.run.run_config import SHORT_NAMES, TRUTH, RunConfig
from hoid_common.errors import ConfigError, InputError, prefixed
from hoid_common.io.files import scratch_folder
from hoid_common.io.yaml_file import parse_yaml
from hoid_common.values import NS_PER_S
from hoid_filter.strategy_registry import STRATEGIES

DETECTOR_HELP = (
    f'ONNX model of the detector, a file or a known name; "{TRUTH}" uses the ground-truth boxes '
    'of a rendered bag (default: search for a model)'
)
_DEFAULT = RunConfig()
_SLOP = 'filter.sync_slop_s'
# Name of the parameter that each option sets.
_SHORTCUTS = {
    **SHORT_NAMES,
    'detector': 'detector.model',
    'min_interaction_area': 'filter.min_interaction_area',
    'depth_limit': 'filter.depth_limit_m',
}


def add_method_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options for strategy, detector, interaction, seed and any other parameter."""
    add_strategy_argument(parser)
    parser.add_argument('--detector', metavar='MODEL', help=DETECTOR_HELP)
    parser.add_argument(
        '--min-interaction-area',
        type=float,
        metavar='A',
        help="share of a handled object's box that a person covers, from 0 to 1 "
        f'(default: {_DEFAULT.filter.min_interaction_area:g})',
    )
    parser.add_argument(
        '--depth-limit',
        type=float,
        metavar='M',
        help='largest depth difference to a handled object in m '
        f'(default: {_DEFAULT.filter.depth_limit_m:g})',
    )
    parser.add_argument(
        '--seed',
        type=int,
        metavar='N',
        help=f'seed of random numbers (default: {_DEFAULT.slam.seed})',
    )
    add_set_argument(parser)


def add_strategy_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--filter',
        choices=STRATEGIES,
        help='strategy that identifies dynamic objects (default: '
        f'{_DEFAULT.filter.strategy}, or {MOTION} without a detector model)',
    )


def add_set_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='set any parameter, such as extraction.num_features=500 or slam.seed=1',
    )


def recording(args: argparse.Namespace) -> Sequence:
    return open_recording(args, args.input, _max_gap_ns(args))


def _max_gap_ns(args: argparse.Namespace) -> int:
    """Return the largest gap (ns) between the stamps of a color image and its depth image.

    It is `filter.sync_slop_s` if the options set it, else the limit of TUM's association tool.
    """
    slop_s = run_config(args).changed().get(_SLOP)
    return MAX_PAIR_GAP_NS if slop_s is None else round(slop_s * NS_PER_S)


@contextmanager
def playable_bag(args: argparse.Namespace) -> Iterator[BagSequence]:
    """Yield the recording that the command line names, as a bag that can be played.

    A folder, or a bag with images in a video or in RGBD messages, is converted to a temporary bag,
    which is removed at the end of the block.
    """
    found = recording(args)
    if isinstance(found, BagSequence) and not found.topics.color.source:
        yield found
        return
    with scratch_folder(args.out, 'bag') as folder:
        path, units = folder / args.input.resolve().name, depth_units_per_m(args)
        choice = TopicChoice()
        if isinstance(found, BagSequence):
            copy_bag(args.input, path, expand=True)
            choice = chosen_topics(args)
        else:
            config = ConvertConfig(depth_units_per_m=units or ConvertConfig().depth_units_per_m)
            convert(args.input, path, config, found.camera, show_progress=True)
            units = None  # the conversion has applied the unit of depth
        gap_ns, offset_ns = _max_gap_ns(args), depth_offset_ns(args)
        yield BagSequence(path, None, choice, gap_ns, offset_ns, units or 0.0)


def run_config(args: argparse.Namespace, base: RunConfig | None = None) -> RunConfig:
    return (base or RunConfig()).updated(given_parameters(args))


def given_parameters(args: argparse.Namespace) -> dict[str, Any]:
    """Return the parameters that the command line sets, by name.

    Names in `--set` stay as the user wrote them, maybe without the short name of the node.
    """
    values: dict[str, Any] = {
        name: getattr(args, option)
        for option, name in _SHORTCUTS.items()
        if getattr(args, option) is not None
    }
    return values | assignments(args.set)


def assignments(texts: Iterable[str]) -> dict[str, Any]:
    """Return the parameters by name in texts NAME=VALUE, where VALUE is YAML.

    A list becomes a tuple. If a name is repeated, its last value counts. ConfigError if a text is
    not NAME=VALUE, or its value is not valid YAML.
    """
    return dict(_assignment(text) for text in texts)


def _assignment(text: str) -> tuple[str, Any]:
    name, sign, value_text = text.partition('=')
    if not sign:
        raise ConfigError(f'--set {text}: expected NAME=VALUE')
    with prefixed('', ConfigError, InputError):
        value = parse_yaml(value_text, f'--set {name}')
    return name, tuple(value) if isinstance(value, list) else value
