"""The commands `save-map`, `load-map`, `set-mode` and `status` for running nodes."""

from __future__ import annotations

import argparse
import sys
import time
from typing import Any

from hoid_msgs.msg import SlamStatus as SlamStatusMsg
from hoid_msgs.srv import LoadMap, SaveMap, SetMode

from hoid_bags.live.ros_session import ros_session
from hoid_bringup.live.node_specs import SLAM
from hoid_common import topics
from hoid_common.errors import InputError
from hoid_common.ros import qos
from hoid_common.ros.conversions.slam import slam_status_from_msg
from hoid_common.ros.execution.executor import SteadyExecutor
from hoid_common.slam_status import SlamMode, SlamState, SlamStatus

_WAIT_S = 10.0  # chosen: discovery takes about a second, on a busy computer several
_RESPONSE_S = 600.0  # chosen: a map of a building takes minutes to save or load
_MEASURED_S = 2.0  # chosen: time during which the rate of images is measured


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
    """Declare the options of `hoid save-map`."""
    parser.add_argument('name', metavar='NAME', help='name of the map in the map directory')
    _add_node_arguments(parser)


def save_map_command(args: argparse.Namespace) -> None:
    """Have the running SLAM node save its map, and print its response with the path of the file.

    Raises:
        InputError: The node is not found in time, does not respond, or cannot save the map.
    """
    _call(args, SaveMap, topics.SAVE_MAP, SaveMap.Request(name=args.name))


def add_load_map_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hoid load-map`."""
    parser.add_argument('name', metavar='NAME', help='name of a map in the map directory')
    parser.add_argument(
        '--merge',
        action='store_true',
        help='keep the running map as well, and merge the two when a known place is recognized',
    )
    _add_node_arguments(parser)


def load_map_command(args: argparse.Namespace) -> None:
    """Have the running SLAM node load a saved map, and print its response.

    Raises:
        InputError: The node is not found in time, does not respond, or cannot load the map.
    """
    _call(args, LoadMap, topics.LOAD_MAP, LoadMap.Request(name=args.name, merge=args.merge))


def add_set_mode_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hoid set-mode`."""
    parser.add_argument(
        'mode',
        choices=[mode.name.lower() for mode in SlamMode],
        help='mapping extends and corrects the map; localization leaves it as it is',
    )
    _add_node_arguments(parser)


def set_mode_command(args: argparse.Namespace) -> None:
    """Switch the running SLAM node to mapping or to localization, and print its response.

    Raises:
        InputError: The node is not found in time, does not respond, or cannot switch.
    """
    _call(args, SetMode, topics.SET_MODE, SetMode.Request(mode=args.mode))


def add_status_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `hoid status`."""
    _add_node_arguments(parser)


def status_command(args: argparse.Namespace) -> None:
    """Print the state of the running SLAM node, the rate of its images and the size of its map.

    The rate is measured for two seconds after the first status.

    Raises:
        InputError: No status arrives within the time of `--wait`.
        MessageError: The status has a state or mode that is unknown here.
    """
    received: list[SlamStatusMsg] = []
    with ros_session('hoid_status', args.namespace) as node:
        subscription = node.create_subscription(
            SlamStatusMsg, topics.SLAM_STATUS, received.append, qos.LATCHED
        )
        executor = SteadyExecutor()
        executor.add_node(node)
        end_s = time.monotonic() + args.wait
        while not received and time.monotonic() < end_s:
            executor.spin_once(timeout_sec=0.1)
        if not received:
            raise InputError(
                f'topic "{subscription.topic_name}": no status in {args.wait:g} s: start '
                '"./hoid nodes", and give its --namespace if it has one'
            )
        first = slam_status_from_msg(received[0])
        start_s, end_s = time.monotonic(), time.monotonic() + _MEASURED_S
        while time.monotonic() < end_s:
            executor.spin_once(timeout_sec=0.1)
        last = slam_status_from_msg(received[-1])
        num_images = last.frames_processed - first.frames_processed
        rate_hz = num_images / (time.monotonic() - start_s)
        sys.stdout.write(f'{status_report(last, rate_hz)}\n')


def status_report(status: SlamStatus, rate_hz: float) -> str:
    """Return the state of the SLAM node as lines of text.

    Args:
        status: The last status.
        rate_hz: Measured rate of processed images in Hz.
    """
    s = status
    state = s.state.name.lower().replace('_', ' ')
    lines = [f'state   {state}, {s.mode.name.lower()}' + (f': {s.message}' if s.message else '')]
    times_ms = ''.join(f', {name} {ms:.1f} ms' for name, ms in s.stage_ms.items())
    lines.append(f'images  {s.frames_processed} processed, {s.frames_dropped} missing')
    if rate_hz > 0:
        lines.append(f'now     {rate_hz:.1f} images per second{times_ms}')
    elif s.state is not SlamState.PAUSED:
        lines.append('now     no image arrives: see docs/howto/nothing_is_tracked.md')
    lines.append(f'pose    {s.inliers} of {s.tracked_points} matched map points agree with it')
    lines.append(
        f'map     {s.keyframes} keyframes, {s.map_points} points, {s.loops} loops'
        + (f', {s.maps} maps that are not merged yet' if s.maps > 1 else '')
    )
    return '\n'.join(lines)


def _call(args: argparse.Namespace, kind: type[Any], service: str, request: Any) -> None:
    """Call a service of the running SLAM node, and print the line of its response.

    Raises:
        InputError: The service is not available in time, does not respond, or fails.
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
