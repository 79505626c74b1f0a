"""Launch arguments and actions that the suite's launch files share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from launch.actions import DeclareLaunchArgument as Argument
from launch.actions import EmitEvent, LogInfo, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited, SignalProcess
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue
from launch_ros.substitutions import FindPackageShare

from hoid_common import topics
from hoid_common.process.entry import EXIT_CONFIG, REFUSAL_PAUSE
from hoid_common.process.signals import FAILURE_SIGNAL
from launch import LaunchContext, LaunchDescription

_SWITCH = ('true', 'false', 'True', 'False')
_LOG_LEVELS = ('debug', 'info', 'warn', 'error', 'fatal')
# Chosen: pause, so that a node that fails at once does not keep a whole processor core busy.
_RESPAWN_DELAY_S = 0.5
# Chosen: pause after a refused start; repeated starts then take a fifth of a processor core.
_REFUSAL_PAUSE_S = 5.0
_SLAM = 'rgbd_slam'  # the package of the node that stores its map


def switch(name: str, description: str, *, default: bool = False) -> Argument:
    return Argument(
        name, default_value=str(default).lower(), description=description, choices=list(_SWITCH)
    )


def common_arguments(package: str, params_file: str) -> list[Argument]:
    """Return the launch arguments of every launch file; `params_file` is a file in `config`."""
    params = PathJoinSubstitution([FindPackageShare(package), 'config', params_file])
    return [
        Argument(
            'namespace', default_value='', description='namespace of nodes, topics and frame tree'
        ),
        Argument('params_file', default_value=params, description='parameter file (YAML)'),
        switch(
            'tf_in_namespace',
            'whether /tf and /tf_static follow the namespace; set it to false to use the global '
            'ones',
            default=True,
        ),
        switch('use_sim_time', 'whether to take the time from /clock'),
        switch(
            'respawn', 'whether to restart a node that died, unless it refused its first start'
        ),
        switch(
            'autostart',
            'whether nodes activate themselves; set it to false for a lifecycle manager',
            default=True,
        ),
        Argument(
            'log_level',
            default_value='info',
            description='log level of the nodes',
            choices=list(_LOG_LEVELS),
        ),
    ]


def value(context: LaunchContext, name: str) -> str:
    return str(LaunchConfiguration(name).perform(context))


def is_on(context: LaunchContext, name: str) -> bool:
    return value(context, name).lower() == 'true'


def suite_node(
    context: LaunchContext,
    package: str,
    parameters: Mapping[str, str],
    remappings: Sequence[tuple[str, str]],
) -> LifecycleNode:
    """Return the launch action of a package's node `<package>_node` with the common arguments.

    The whole launch ends if the node refuses its first start, or if it fails without `respawn`. A
    running SLAM node then gets FAILURE_SIGNAL first, so that its map is kept.
    """
    respawn = is_on(context, 'respawn')
    switches = {name: is_on(context, name) for name in ('use_sim_time', 'autostart')}
    # The value stays a string even if it looks like a number.
    texts = {name: ParameterValue(text, value_type=str) for name, text in parameters.items()}
    return LifecycleNode(
        package=package,
        executable=f'{package}_node',
        name=package,
        namespace=LaunchConfiguration('namespace'),
        parameters=[
            ParameterFile(LaunchConfiguration('params_file'), allow_substs=True),
            switches | texts,
        ],
        remappings=[*remappings, *tf_remappings(context)],
        arguments=['--ros-args', '--log-level', value(context, 'log_level')],
        additional_env={REFUSAL_PAUSE: str(_REFUSAL_PAUSE_S if respawn else 0.0)},
        output='screen',
        respawn=respawn,
        respawn_delay=_RESPAWN_DELAY_S,
        on_exit=_ending_launch(package, respawn=respawn),
    )


def tf_remappings(context: LaunchContext) -> list[tuple[str, str]]:
    return list(topics.NAMESPACED_TF) if is_on(context, 'tf_in_namespace') else []


def camera_arguments() -> list[Argument]:
    return [
        Argument('image', default_value=topics.RGB_IMAGE, description='topic of color images'),
        Argument(
            'depth',
            default_value=topics.DEPTH_IMAGE,
            description='topic of depth images, registered to the color images',
        ),
        Argument(
            'camera_info',
            default_value=topics.CAMERA_INFO,
            description='topic of the camera_info of the color images',
        ),
    ]


def camera_remappings(context: LaunchContext) -> list[tuple[str, str]]:
    names = [value(context, name) for name in ('image', 'depth', 'camera_info')]
    return topics.camera_remappings(*names)


def one_node(
    package: str, parameters: Mapping[str, str], arguments: Sequence[Argument]
) -> LaunchDescription:
    def node(context: LaunchContext) -> list[LifecycleNode]:
        values = {name: value(context, argument) for name, argument in parameters.items()}
        return [suite_node(context, package, values, camera_remappings(context))]

    common = common_arguments(package, f'{package}.yaml')
    return LaunchDescription(
        [*common, *camera_arguments(), *arguments, OpaqueFunction(function=node)]
    )


def _ending_launch(
    package: str, *, respawn: bool
) -> Callable[[ProcessExited, LaunchContext], list[Any]]:
    """Return the handler of a node's exit, which ends the whole launch after a failure.

    With `respawn`, only a node that refuses its first start ends the launch; without it, every
    exit status other than 0 does (decision 046).
    """
    has_run = False

    def on_exit(event: ProcessExited, context: LaunchContext) -> list[Any]:
        nonlocal has_run
        if context.is_shutdown:
            # A node that is interrupted while it starts exits with the status of an interrupt: no
            # error.
            return []
        is_refusal = event.returncode == EXIT_CONFIG
        has_run = has_run or not is_refusal
        what = 'refused to start' if is_refusal else f'ended with status {event.returncode}'
        if respawn and has_run:
            tried = f'{package} {what}; the other nodes run on, and it is tried again'
            return [LogInfo(msg=tried)] if is_refusal else []
        if event.returncode == 0:
            return []
        hint = '; see its last line of output' if is_refusal else ''
        failure = SignalProcess(signal_number=FAILURE_SIGNAL, process_matcher=_stores_a_map)
        return [EmitEvent(event=failure), Shutdown(reason=f'{package} {what}{hint}')]

    return on_exit


def _stores_a_map(process: Any) -> bool:
    is_slam = isinstance(process, LifecycleNode) and process.node_package == _SLAM
    return is_slam and 'pid' in (process.process_details or {})
