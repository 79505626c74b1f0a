"""The command `nodes`, which runs all nodes of the suite on a robot as supervised processes."""

from __future__ import annotations

import argparse
import re
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from hoid_bringup.live.budget import use_cores, within_budget
from hoid_bringup.live.node_specs import DETECTOR, FILTER, SCENE, SLAM, NodeOptions, node_specs
from hoid_bringup.live.supervisor import ProcessExit, Supervisor
from hoid_bringup.run.no_detector import MOTION, NO_DETECTOR, has_model
from hoid_bringup.run.options import add_set_argument, add_strategy_argument, assignments
from hoid_bringup.run.run_config import RunConfig
from hoid_common.camera_topics import CAMERA_TOPICS
from hoid_common.errors import ConfigError, InputError
from hoid_common.io.yaml_file import load_params
from hoid_common.process.limits import require_node_limits
from hoid_common.process.shared_memory import clean_shared_memory
from hoid_common.store.map_directory import existing_map
from hoid_common.topics import IMU, NAMESPACED_TF
from hoid_detector.model.model_path import find_model
from rgbd_slam.config.node_config import SlamNodeConfig

_TICK_S = 0.05  # chosen: longest delay until a node's end is noticed
_NAMESPACE = re.compile(r'/?([A-Za-z_]\w*(/[A-Za-z_]\w*)*/?)?', re.ASCII)
_PROGRESS = re.compile(r'\]: tracking, |\[DEBUG\]')
_ALL = (DETECTOR, FILTER, SLAM, SCENE)


def add_nodes_arguments(parser: argparse.ArgumentParser) -> None:
    _add_topic_options(parser)
    _add_parameter_options(parser)
    _add_process_options(parser)


def _add_topic_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--namespace', default='', metavar='NS', help='namespace of nodes, topics and frame tree'
    )
    parser.add_argument(
        '--global-tf',
        action='store_true',
        help='with --namespace: use the global /tf and /tf_static',
    )
    parser.add_argument(
        '--camera',
        '--topics',
        dest='topics',
        choices=tuple(CAMERA_TOPICS),
        default='bag',
        help="camera driver (default: the suite's own names)",
    )
    parser.add_argument(
        '--camera-namespace',
        default='',
        metavar='NS',
        help="namespace of the camera driver (default: the driver's own default)",
    )
    parser.add_argument(
        '--compressed',
        action='store_true',
        help='subscribe to .../compressed and .../compressedDepth',
    )
    parser.add_argument(
        '--imu', metavar='TOPIC', help='topic of an IMU (default: imu, which need not exist)'
    )


def _add_parameter_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--params', type=Path, metavar='YAML', help='ROS parameter file for the nodes'
    )
    add_strategy_argument(parser)
    add_set_argument(parser)
    parser.add_argument(
        '--detector',
        metavar='MODEL',
        help='ONNX model of the detector, a file or a known name (default: search for a model)',
    )
    parser.add_argument(
        '--base', metavar='FRAME', help='base frame of the robot; /tf_static places the camera'
    )


def _add_process_options(parser: argparse.ArgumentParser) -> None:
    selection = parser.add_mutually_exclusive_group()
    selection.add_argument(
        '--no-detector',
        action='store_true',
        help='do not start the detector',
    )
    selection.add_argument(
        '--only',
        choices=_ALL,
        help='start this node only',
    )
    parser.add_argument(
        '--no-scene',
        action='store_true',
        help='do not start the scene node: no dense map, grid, people, objects',
    )
    parser.add_argument(
        '--cores',
        type=int,
        metavar='N',
        help='use at most N cores (default: all); with one, odometry comes first',
    )
    parser.add_argument(
        '--restart',
        action='store_true',
        help='restart a node that ended, unless it refused its first start, instead of ending all',
    )
    parser.add_argument('--sim-time', action='store_true', help='use the time of /clock')
    parser.add_argument(
        '--log-dir', type=Path, metavar='DIR', help='folder for one log file per node'
    )


def nodes_command(args: argparse.Namespace) -> None:
    """Run the nodes until Ctrl-C or SIGTERM, or until a node ends that is not restarted."""
    require_node_limits()  # the nodes inherit these limits
    options = node_options(args)
    check_files(options)
    options = within_budget(without_detector(options), use_cores(args.cores))
    specs = node_specs(options)
    try:
        with suppress(KeyboardInterrupt):
            supervisor = Supervisor(specs, restart=args.restart, log_dir=args.log_dir)
            try:
                _supervise(supervisor)
            finally:
                _show_logs(supervisor)
    finally:
        clean_shared_memory()


def _supervise(supervisor: Supervisor) -> None:
    """Run the nodes until an interrupt; InputError if a node ends and is not restarted."""
    with supervisor:
        _say(f'{", ".join(supervisor.pids)} started; Ctrl-C ends them')
        try:
            while True:
                _show_logs(supervisor)
                for ended in supervisor.poll():
                    _report_end(ended)
                time.sleep(_TICK_S)
        except KeyboardInterrupt:
            _say('ending the nodes, which keep their map')
            raise


def _report_end(ended: ProcessExit) -> None:
    if ended.restart_s is None:
        raise InputError(f'{ended}; see its last lines of output')
    what = 'restarting it'
    if ended.refused_to_start:
        what = f'the other nodes run on; trying again in {ended.restart_s:.0f} s'
    _say(f'{ended}; {what}')


def _show_logs(supervisor: Supervisor) -> None:
    """Print new lines of the nodes' log files, except for progress reports."""
    for line in supervisor.new_log_lines():
        if not _PROGRESS.search(line):
            sys.stderr.write(f'{line}\n')


def _say(text: str) -> None:
    sys.stderr.write(f'hoid nodes: {text}\n')
    sys.stderr.flush()


def node_options(args: argparse.Namespace) -> NodeOptions:
    for option in ('namespace', 'camera_namespace'):
        if not _NAMESPACE.fullmatch(namespace := getattr(args, option)):
            name = option.replace('_', '-')
            raise ConfigError(f'--{name} {namespace}: use letters, digits, _ and / only')
    if args.params is not None:
        for node in _ALL:
            load_params(args.params, node)
    parameters: dict[str, dict[str, Any]] = {node: {} for node in _ALL}
    for node, name, value in (
        (DETECTOR, 'model', args.detector),
        (FILTER, 'strategy', args.filter),
        (SLAM, 'frames.base', args.base),
        (DETECTOR, 'base_frame', args.base),
    ):
        if value is not None:
            parameters[node][name] = value
    for node, values in set_parameters(args.set).items():
        parameters[node] |= values
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
            *([(IMU, args.imu)] if args.imu else ()),
            *(() if args.global_tf else NAMESPACED_TF),
        ),
        parameters=parameters,
    )


def check_files(options: NodeOptions) -> None:
    """Raise an error, before any node starts, if the configured model or map does not exist."""
    if model := options.given(DETECTOR).get('model'):
        find_model(model)
    slam = options.given(SLAM)
    if name := slam.get('map_file'):
        existing_map(slam.get('map_directory', SlamNodeConfig().map_directory), name)


def set_parameters(texts: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the parameters of `--set` options by node and name; ConfigError if one is invalid."""
    values = assignments(texts)
    return RunConfig().updated(values).named(values)


def without_detector(options: NodeOptions) -> NodeOptions:
    """Return options with the strategy `motion` if no detector model is found.

    The options are unchanged if detector or filter is not started, if the user has set a model or
    a strategy, or if a model is found or downloaded (see `has_model`).
    """
    is_chosen = 'model' in options.given(DETECTOR) or 'strategy' in options.given(FILTER)
    if is_chosen or not {DETECTOR, FILTER} <= set(options.nodes) or has_model():
        return options
    _say(NO_DETECTOR)
    filter_parameters = {**options.parameters[FILTER], 'strategy': MOTION}
    return replace(
        options,
        nodes=tuple(node for node in options.nodes if node != DETECTOR),
        parameters={**options.parameters, FILTER: filter_parameters},
    )


def _chosen(args: argparse.Namespace) -> tuple[str, ...]:
    if args.only is not None:
        return (args.only,)
    left_out = {DETECTOR: args.no_detector, SCENE: args.no_scene}
    return tuple(node for node in _ALL if not left_out.get(node, False))
