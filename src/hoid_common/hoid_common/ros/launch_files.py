"""What the suite's launch files share; needs ROS's launch packages."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from launch.actions import DeclareLaunchArgument as Argument
from launch.actions import OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue
from launch_ros.substitutions import FindPackageShare

from hoid_common import topics
from hoid_common.process.entry import REFUSED
from launch import LaunchContext, LaunchDescription

_SWITCH = ('true', 'false', 'True', 'False')
_LOG_LEVELS = ('debug', 'info', 'warn', 'error', 'fatal')
_RESPAWN_DELAY_S = 0.5


def switch(name: str, description: str, *, default: bool = False) -> Argument:
    """Return a launch argument that is true or false."""
    return Argument(
        name, default_value=str(default).lower(), description=description, choices=list(_SWITCH)
    )


def common_arguments(package: str, params_file: str) -> list[Argument]:
    """Return the launch arguments that all launch files take.

    Args:
        package: Whose parameter file is the default.
        params_file: Its name in the package's folder `config`.
    """
    params = PathJoinSubstitution([FindPackageShare(package), 'config', params_file])
    return [
        Argument('namespace', default_value='', description='of nodes, topics and frame tree'),
        Argument('params_file', default_value=params, description='parameters, YAML'),
        switch('use_sim_time', 'take the time from /clock'),
        switch('respawn', 'start a node that died anew, unless it refused what it was given'),
        switch(
            'autostart', 'become active at once; false waits for a lifecycle manager', default=True
        ),
        Argument(
            'log_level',
            default_value='info',
            description='of the nodes',
            choices=list(_LOG_LEVELS),
        ),
    ]


def value(context: LaunchContext, name: str) -> str:
    """Return what a launch argument was set to."""
    return str(LaunchConfiguration(name).perform(context))


def is_on(context: LaunchContext, name: str) -> bool:
    """Return what a switch was set to."""
    return value(context, name).lower() == 'true'


def suite_node(
    context: LaunchContext,
    package: str,
    parameters: Mapping[str, str],
    remappings: Sequence[tuple[str, str]],
) -> LifecycleNode:
    """Return the node of a package, as the common launch arguments ask for.

    It is required: when it refuses what it was given, or dies and is not to be started anew, the
    launch ends.

    Args:
        context: Of the launch.
        package: That has it.
        parameters: Text by name, on top of the parameter file.
        remappings: Of its topics, but for the frame tree's, which follows the namespace.
    """
    respawn = is_on(context, 'respawn')
    switches = {name: is_on(context, name) for name in ('use_sim_time', 'autostart')}
    # Text stays text, also when it looks like a number.
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
        remappings=[*remappings, *topics.NAMESPACED_TF],
        arguments=['--ros-args', '--log-level', value(context, 'log_level')],
        output='screen',
        respawn=respawn,
        respawn_delay=_RESPAWN_DELAY_S,
        on_exit=_ending_launch(package, respawn=respawn),
    )


def camera_arguments() -> list[Argument]:
    """Return the launch arguments that name a camera's topics, as one node's launch file does."""
    return [
        Argument('image', default_value=topics.RGB_IMAGE, description='colour topic'),
        Argument('depth', default_value=topics.DEPTH_IMAGE, description='registered depth topic'),
        Argument('camera_info', default_value=topics.CAMERA_INFO, description='of the colour'),
    ]


def camera_remappings(context: LaunchContext) -> list[tuple[str, str]]:
    """Return the remaps that `camera_arguments` ask for."""
    names = [value(context, name) for name in ('image', 'depth', 'camera_info')]
    return topics.camera_remappings(*names)


def one_node(
    package: str, parameters: Mapping[str, str], arguments: Sequence[Argument]
) -> LaunchDescription:
    """Return the launch description of one node alone.

    Args:
        package: That has it.
        parameters: Launch argument by name of the parameter that it sets.
        arguments: Those launch arguments.
    """

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
    def on_exit(event: ProcessExited, _context: LaunchContext) -> list[Any]:
        if event.returncode == REFUSED:
            return [Shutdown(reason=f'{package} refused to start; its last line says why')]
        if event.returncode != 0 and not respawn:
            return [Shutdown(reason=f'{package} ended with status {event.returncode}')]
        return []

    return on_exit
