"""The commands `convert`, `info`, `play` and `record`."""

from __future__ import annotations

import argparse
from pathlib import Path

from hoid_bags import options
from hoid_bags.bag.bag_reader import is_bag
from hoid_bags.bag.info import describe, summarize
from hoid_bags.bag.repair import copy_bag, repair
from hoid_bags.convert import ConvertConfig, convert
from hoid_bags.live.playback import PlayConfig
from hoid_common.errors import ConfigError, InputError

_BAG_HELP = 'bag folder, or .mcap, .db3 or .bag file'


def add_convert_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        'sequence',
        type=Path,
        metavar='RECORDING',
        help='folder of images, .sens file, or ROS 1 bag',
    )
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder of the new bag')
    options.add_folder_arguments(parser)
    options.add_config_arguments(parser, ConvertConfig())


def convert_command(args: argparse.Namespace) -> None:
    """Convert a recording to a bag, and print the summary of the bag.

    A recording that is a bag itself is copied by `copy_bag` with `expand`. HoidError as in
    `convert` and `copy_bag`, or at the end if that bag is damaged.
    """
    fault = None
    config = options.config_from(
        args, ConvertConfig, depth_units_per_m=options.depth_units_per_m(args) or 0.0
    )
    if is_bag(args.sequence):
        _refuse_folder_options(args, config)
        fault = copy_bag(args.sequence, args.bag, compress=config.compress, expand=True)
    else:
        convert(args.sequence, args.bag, config, options.chosen_camera(args), show_progress=True)
    print(describe(summarize(args.bag)))
    if fault is not None:
        raise InputError(fault)


def _refuse_folder_options(args: argparse.Namespace, config: ConvertConfig) -> None:
    default = ConvertConfig()
    given = {
        '--rgb': config.rgb != default.rgb,
        '--depth': config.depth != default.depth,
        '--round-depth': config.round_depth,
        '--calibration': args.calibration is not None,
        '--depth-factor': args.depth_factor is not None,
    }
    if refused := [option for option, is_given in given.items() if is_given]:
        raise ConfigError(f'{", ".join(refused)}: only for folders; a bag is copied as it is')


def add_info_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', type=Path, metavar='BAG', help=_BAG_HELP)
    parser.add_argument(
        '--bandwidth',
        action='store_true',
        help='also list the bandwidth of each topic',
    )
    parser.add_argument(
        '--repair',
        action='store_true',
        help='first restore what is intact of a damaged bag',
    )


def info_command(args: argparse.Namespace) -> None:
    """Print the topics of a bag with message counts and rates; with `--repair`, repair it first.

    InputError: the bag cannot be read or repaired; or, after printing, it is damaged.
    """
    bag = repair(args.bag) if args.repair else args.bag
    summary = summarize(bag, sizes=args.bandwidth)
    print(describe(summary))
    if summary.fault is not None:
        raise InputError(summary.fault)


def add_play_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', type=Path, metavar='BAG', help=_BAG_HELP)
    parser.add_argument(
        '--topics', nargs='+', default=[], metavar='TOPIC', help='topics to publish (default: all)'
    )
    parser.add_argument('--namespace', default='', metavar='NS', help='namespace for all topics')
    options.add_config_arguments(parser, PlayConfig())
    options.add_topic_arguments(parser)
    parser.add_argument(
        '--require',
        action='append',
        default=[],
        metavar='TOPIC=N',
        help='start when TOPIC has N subscribers',
    )


def play_command(args: argparse.Namespace) -> None:
    from hoid_bags.live.play import play  # needs ROS, which convert and info do not

    play(
        args.bag,
        options.config_from(args, PlayConfig),
        topic_names=tuple(args.topics),
        namespace=args.namespace,
        choice=options.chosen_topics(args),
        depth_offset_ns=options.depth_offset_ns(args),
        min_subscribers=dict(_requirement(text) for text in args.require),
        show_progress=True,
    )


def add_record_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder of the new bag')
    parser.add_argument(
        '--topics',
        nargs='+',
        default=[],
        metavar='TOPIC',
        help='topics to record (default: the results of the suite)',
    )
    parser.add_argument(
        '--namespace', default='', metavar='NS', help='namespace of relative topics'
    )
    parser.add_argument(
        '--duration',
        type=float,
        default=0.0,
        metavar='S',
        help='time to record in s; 0: until an interrupt',
    )
    parser.add_argument(
        '--use-sim-time', action='store_true', help='use the time of /clock instead of wall time'
    )


def record_command(args: argparse.Namespace) -> None:
    from hoid_bags.live.record import RESULT_TOPICS, record  # needs ROS

    count = record(
        args.bag,
        tuple(args.topics) or RESULT_TOPICS,
        namespace=args.namespace,
        duration_s=args.duration,
        use_sim_time=args.use_sim_time,
        show_progress=True,
    )
    print(f'{args.bag}: {count} messages')


def _requirement(text: str) -> tuple[str, int]:
    topic, _, count = text.rpartition('=')
    if not topic or not count.isdecimal():
        raise ConfigError(f'--require {text}: expected TOPIC=N, such as rgb/image=3')
    return topic, int(count)
