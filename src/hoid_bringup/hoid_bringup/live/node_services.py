"""The commands `save-map`, `load-map`, `set-mode` and `status`, which talk to running nodes."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from hoid_msgs.msg import SlamStatus as SlamStatusMsg
from hoid_msgs.srv import LoadMap, SaveMap, SetMode

from hoid_bags.live.ros_session import ros_session
from hoid_bringup.live.node_specs import NODE_CONFIGS, SLAM
from hoid_common import topics
from hoid_common.errors import InputError
from hoid_common.ros import qos
from hoid_common.ros.conversions.slam import slam_status_from_msg
from hoid_common.ros.execution.executor import SteadyExecutor
from hoid_common.slam_status import SlamMode, SlamState, SlamStatus

_WAIT_S = 10.0  # chosen: discovery takes about a second, or several on a busy computer
_RESPONSE_S = 600.0  # chosen: saving or loading the map of a building takes minutes
_MEASURED_S = 2.0  # chosen: duration of the measurement of the image rate
# Wait if there are no images: a node reports an input that is silent for 2 s in its next message
# on /diagnostics, at 1 Hz.
_SILENT_S = 3.5


def _add_node_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--namespace', default='', metavar='NS', help='namespace of the nodes (default: none)'
    )
    parser.add_argument(
        '--wait',
        type=float,
        default=_WAIT_S,
        metavar='S',
        help='longest time to wait for the running node in s (default: %(default)g)',
    )


def add_save_map_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('name', metavar='NAME', help='name of the map in the map directory')
    _add_node_arguments(parser)


def save_map_command(args: argparse.Namespace) -> None:
    _call(args, SaveMap, topics.SAVE_MAP, SaveMap.Request(name=args.name))


def add_load_map_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('name', metavar='NAME', help='name of a map in the map directory')
    parser.add_argument(
        '--merge',
        action='store_true',
        help='keep the running map, and merge both at a known place',
    )
    _add_node_arguments(parser)


def load_map_command(args: argparse.Namespace) -> None:
    _call(args, LoadMap, topics.LOAD_MAP, LoadMap.Request(name=args.name, merge=args.merge))


def add_set_mode_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        'mode',
        choices=[mode.name.lower() for mode in SlamMode],
        help='localization leaves the map as it is',
    )
    _add_node_arguments(parser)


def set_mode_command(args: argparse.Namespace) -> None:
    _call(args, SetMode, topics.SET_MODE, SetMode.Request(mode=args.mode))


def add_status_arguments(parser: argparse.ArgumentParser) -> None:
    _add_node_arguments(parser)


def status_command(args: argparse.Namespace) -> None:
    """Print which nodes run and what they lack, and the state, images and map of the SLAM node.

    For two seconds after the first message of a node, the command waits for other nodes and counts
    images. Without images, it waits longer, so that the nodes can report the reason. InputError if
    no node reports within `--wait` seconds.
    """
    statuses: list[SlamStatusMsg] = []
    reports: list[DiagnosticArray] = []
    with ros_session('hoid_status', args.namespace) as node:
        node.create_subscription(SlamStatusMsg, topics.SLAM_STATUS, statuses.append, qos.LATCHED)
        node.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, reports.append, qos.OUTPUT)
        prefix = node.resolve_topic_name('x').removesuffix('x')
        executor = SteadyExecutor()
        executor.add_node(node)
        end_s = time.monotonic() + args.wait
        while not _messages_by_node(reports, prefix) and time.monotonic() < end_s:
            executor.spin_once(timeout_sec=0.1)
        num_before, start_s = len(statuses), time.monotonic()
        while time.monotonic() < start_s + _MEASURED_S:
            executor.spin_once(timeout_sec=0.1)
        # The first status is the latched one, of an earlier image.
        num_images = len(statuses) - max(num_before, 1)
        while num_images <= 0 and time.monotonic() < start_s + _SILENT_S:
            executor.spin_once(timeout_sec=0.1)
        nodes = _messages_by_node(reports, prefix)
        if not nodes:
            raise InputError(_nobody(node.get_node_names_and_namespaces(), prefix, args.wait))
    rate_hz = num_images / _MEASURED_S
    last = slam_status_from_msg(statuses[-1]) if statuses else None
    sys.stdout.write(f'{status_report(nodes, last, rate_hz)}\n')


def _messages_by_node(reports: Sequence[DiagnosticArray], prefix: str) -> dict[str, str]:
    return {
        status.name.removeprefix(prefix): status.message
        for report in reports
        for status in report.status
        if status.name.startswith(prefix) and status.name.removeprefix(prefix) in NODE_CONFIGS
    }


def _nobody(names: Sequence[tuple[str, str]], prefix: str, wait_s: float) -> str:
    """Return the error text for a namespace in which no node of the suite reports."""
    domain = os.environ.get('ROS_DOMAIN_ID', '0')
    where = sorted({space for name, space in names if name in NODE_CONFIGS})
    text = f'no node of the suite reports in namespace {prefix} of ROS domain {domain}'
    if others := ', '.join(space for space in where if f'{space.rstrip("/")}/' != prefix):
        return f'{text}, but there are some in {others}: give that as --namespace'
    return f'{text} in {wait_s:g} s: start "./hoid nodes"'


def status_report(nodes: Mapping[str, str], status: SlamStatus | None, rate_hz: float) -> str:
    """Return a text about the nodes and the state of the SLAM node (None: no status received)."""
    lines = [
        f'{"" if n else "nodes":7s} {name}: {text}' for n, (name, text) in enumerate(nodes.items())
    ]
    if any('no publisher' in text for text in nodes.values()):
        lines.append(
            'to do   start the camera driver or play a bag; if its topics have other names, '
            'restart "./hoid nodes" with --camera'
        )
    elif any(', silent' in text or 'requests' in text for text in nodes.values()):
        lines.append('to do   see docs/howto/nothing_is_tracked.md')
    return '\n'.join([*lines, *_slam_lines(status, rate_hz)])


def _slam_lines(status: SlamStatus | None, rate_hz: float) -> list[str]:
    if status is None:
        return ['state   no image was processed yet']
    s = status
    state = f'{s.state.name.lower().replace("_", " ")}, {s.mode.name.lower()}'
    if rate_hz <= 0 and s.state is not SlamState.PAUSED:
        state = f'no image arrives; before that: {state}'
    lines = [f'state   {state}' + (f': {s.message}' if s.message else '')]
    times_ms = ''.join(f', {name} {ms:.1f} ms' for name, ms in s.stage_ms.items())
    lines.append(
        f'images  {s.frames_processed} processed, {s.frames_dropped} missing (by gaps between the '
        'stamps of those received)'
    )
    if rate_hz > 0:
        lines.append(f'now     {rate_hz:.1f} images per second{times_ms}')
    lines.append(f'pose    {s.inliers} of {s.tracked_points} matched map points agree with it')
    lines.append(
        f'map     {s.keyframes} keyframes, {s.map_points} points, {s.loops} loops'
        + (f', {s.maps} maps that are not merged yet' if s.maps > 1 else '')
    )
    return lines


def _call(args: argparse.Namespace, kind: type[Any], service: str, request: Any) -> None:
    """Call a service of the running SLAM node, and print the message of its response.

    InputError if the service is not available in time, does not respond, or fails.
    """
    with ros_session('hoid_client', args.namespace) as node:
        name = node.resolve_service_name(service.replace('~', SLAM))
        client = node.create_client(kind, name)
        executor = SteadyExecutor()
        executor.add_node(node)
        if not client.wait_for_service(args.wait):
            raise InputError(
                f'service "{name}": not available after {args.wait:g} s: start '
                '"./hoid nodes", and give its --namespace if it has one'
            )
        future = client.call_async(request)
        executor.spin_until_future_complete(future, _RESPONSE_S)
        response = future.result() if future.done() else None
        if response is None:
            raise InputError(f'service "{name}": no response in {_RESPONSE_S:g} s')
        if not response.success:
            raise InputError(f'service "{name}": {response.message}')
        sys.stdout.write(f'{response.message}\n')
