"""`hoid nodes`: the three nodes for a live robot, supervised."""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from hoid_bringup.live.camera_topics import CAMERA_TOPICS
from hoid_bringup.live.node_specs import DETECTOR, FILTER, SLAM, NodeOptions, node_specs
from hoid_bringup.live.supervisor import Supervisor
from hoid_bringup.run.no_detector import MOTION, NO_DETECTOR, has_model
from hoid_bringup.run.options import add_set_argument, assignments
from hoid_bringup.run.run_config import RunConfig
from hoid_common.errors import ConfigError, InputError
from hoid_common.io.param_file import load_params
from hoid_common.process.shared_memory import clean_shared_memory
from hoid_common.topics import NAMESPACED_TF

_TICK_S = 0.05
_NAMESPACE = re.compile(r'/?([A-Za-z_]\w*(/[A-Za-z_]\w*)*/?)?', re.ASCII)
_ALL = (DETECTOR, FILTER, SLAM)


def add_nodes_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hoid nodes`."""
    parser.add_argument('--params', type=Path, metavar='YAML', help='ROS parameter file')
    parser.add_argument(
        '--namespace', default='', metavar='NS', help='of nodes, topics and the frame tree'
    )
    parser.add_argument(
        '--camera',
        '--topics',
        dest='topics',
        choices=tuple(CAMERA_TOPICS),
        default='bag',
        help="camera driver whose topics are taken (default: the suite's own names)",
    )
    parser.add_argument(
        '--camera-namespace', default='', metavar='NS', help='of the driver (default: its own)'
    )
    parser.add_argument('--filter', metavar='STRATEGY', help='of the filter')
    add_set_argument(parser)
    parser.add_argument('--detector', metavar='MODEL', help='ONNX file or name of a known model')
    parser.add_argument('--base', metavar='FRAME', help="robot's base frame, on /tf_static")
    some = parser.add_mutually_exclusive_group()
    some.add_argument(
        '--no-detector', action='store_true', help='it runs elsewhere, or nothing needs it'
    )
    some.add_argument(
        '--only', choices=_ALL, help='just this one, such as the detector on another computer'
    )
    parser.add_argument(
        '--compressed',
        action='store_true',
        help='take images from .../compressed and .../compressedDepth',
    )
    parser.add_argument(
        '--restart', action='store_true', help='start a node that died anew instead of ending all'
    )
    parser.add_argument('--sim-time', action='store_true', help='take the time from /clock')
    parser.add_argument('--log-dir', type=Path, metavar='DIR', help='one file per node')


def nodes_command(args: argparse.Namespace) -> None:
    """Run until Ctrl-C or SIGTERM, which is the usual end, or until a node dies."""
    options = without_detector(node_options(args))
    with tempfile.TemporaryDirectory(prefix='hoid-') as folder, suppress(KeyboardInterrupt):
        specs = node_specs(options, Path(folder))
        try:
            _supervise(Supervisor(specs, restart=args.restart, log_dir=args.log_dir), args.restart)
        finally:
            clean_shared_memory()


def _supervise(supervisor: Supervisor, restart: bool) -> None:
    """Watch the nodes for ever.

    Raises:
        InputError: One died and was not to be restarted, or refused to start.
    """
    with supervisor:
        while True:
            for ended in supervisor.poll():
                if ended.was_refusal or not restart:
                    raise InputError(f'{ended}; its last lines above say why')
                sys.stderr.write(f'hoid nodes: {ended}; starting it anew\n')
            time.sleep(_TICK_S)


def node_options(args: argparse.Namespace) -> NodeOptions:
    """Return what the options ask for.

    Raises:
        ConfigError: The parameter file is missing or none, or a namespace is no valid name.
    """
    for option in ('namespace', 'camera_namespace'):
        if not _NAMESPACE.fullmatch(given := getattr(args, option)):
            name = option.replace('_', '-')
            raise ConfigError(f'--{name} {given}: use letters, digits, _ and / only')
    if args.params is not None:
        for node in _ALL:
            load_params(args.params, node)
    parameters: dict[str, dict[str, Any]] = {node: {} for node in _ALL}
    for node, name, value in (
        (DETECTOR, 'model', args.detector),
        (FILTER, 'strategy', args.filter),
        (SLAM, 'frames.base', args.base),
    ):
        if value is not None:
            parameters[node][name] = value
    for node, given in set_parameters(args.set).items():
        parameters[node] |= given
    if args.compressed:
        for chosen in parameters.values():
            chosen['input.compressed'] = True
    names = CAMERA_TOPICS[args.topics].remappings(args.camera_namespace)
    own_names = CAMERA_TOPICS['bag'].remappings()
    return NodeOptions(
        nodes=_chosen(args),
        namespace=args.namespace,
        use_sim_time=args.sim_time,
        params_file=args.params,
        remappings=(
            *(pair for pair in names if pair not in own_names),
            *NAMESPACED_TF,
        ),
        parameters=parameters,
    )


def set_parameters(texts: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return what `--set` asks for by node, names and values checked.

    Raises:
        ConfigError: One is no NAME=VALUE, or its name is unknown or its value out of range.
    """
    values = assignments(texts)
    return RunConfig().updated(values).named(values)


def without_detector(options: NodeOptions) -> NodeOptions:
    """Return the options, by motion alone where a detector would run and no model is found."""
    asked = {
        (node, name)
        for node in (DETECTOR, FILTER)
        for name in (
            *options.parameters[node],
            *(load_params(options.params_file, node) if options.params_file else ()),
        )
    }
    whole_suite = DETECTOR in options.nodes and FILTER in options.nodes
    if not whole_suite or asked & {(DETECTOR, 'model'), (FILTER, 'strategy')} or has_model():
        return options
    sys.stderr.write(f'hoid nodes: {NO_DETECTOR}\n')
    filter_parameters = {**options.parameters[FILTER], 'strategy': MOTION}
    return replace(
        options,
        nodes=tuple(node for node in options.nodes if node != DETECTOR),
        parameters={**options.parameters, FILTER: filter_parameters},
    )


def _chosen(args: argparse.Namespace) -> tuple[str, ...]:
    if args.only is not None:
        return (args.only,)
    return (FILTER, SLAM) if args.no_detector else _ALL
