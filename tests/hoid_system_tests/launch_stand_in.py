"""Runs the launch files as `ros2 launch` does, for machines without ROS's launch packages.

    python -m hoid_system_tests.launch_stand_in FILE NAME:=VALUE ...

It follows launch 3.4: a process that ended is restarted (`respawn`), `on_exit` may request a
shutdown, and then every process gets SIGINT, even if a terminal has sent it before.
"""

from __future__ import annotations

import os
import runpy
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import yaml

from hoid_system_tests.processes import executable

_TICK_S, _SIGTERM_AFTER_S, _SIGKILL_AFTER_S = 0.02, 5.0, 10.0
NAMES = {
    'launch': 'LaunchContext LaunchDescription',
    'launch.actions': 'DeclareLaunchArgument EmitEvent LogInfo OpaqueFunction Shutdown',
    'launch.events': '',
    'launch.events.process': 'ProcessExited SignalProcess',
    'launch.substitutions': 'LaunchConfiguration PathJoinSubstitution',
    'launch_ros': '',
    'launch_ros.actions': 'LifecycleNode Node',
    'launch_ros.parameter_descriptions': 'ParameterFile ParameterValue',
    'launch_ros.substitutions': 'FindPackageShare',
}


@dataclass
class LaunchContext:
    launch_configurations: dict[str, str]
    is_shutdown: bool = False


class Substitution:
    def perform(self, context: LaunchContext) -> str:
        raise NotImplementedError


@dataclass
class LaunchConfiguration(Substitution):
    name: str

    def perform(self, context: LaunchContext) -> str:
        return context.launch_configurations[self.name]


@dataclass
class FindPackageShare(Substitution):
    package: str

    def perform(self, _context: LaunchContext) -> str:
        for prefix in os.environ['AMENT_PREFIX_PATH'].split(os.pathsep):
            if (path := Path(prefix) / 'share' / self.package).is_dir():
                return str(path)
        raise FileNotFoundError(f'package {self.package} is not installed')


@dataclass
class PathJoinSubstitution(Substitution):
    parts: list[Substitution | str]

    def perform(self, context: LaunchContext) -> str:
        return str(Path(*(text(part, context) for part in self.parts)))


@dataclass
class ParameterFile:
    param_file: Any
    allow_substs: bool = False


@dataclass
class ParameterValue:
    value: Any
    value_type: type[Any]


@dataclass
class DeclareLaunchArgument:
    name: str
    default_value: Any
    description: str
    choices: list[str] = field(default_factory=list)

    def execute(self, context: LaunchContext) -> None:
        given = context.launch_configurations.setdefault(
            self.name, text(self.default_value, context)
        )
        if self.choices and given not in self.choices:
            raise SystemExit(f'{self.name} {given} is not one of {self.choices}')


@dataclass
class OpaqueFunction:
    function: Callable[[LaunchContext], list[Node]]


@dataclass
class Shutdown:
    reason: str


@dataclass
class LogInfo:
    msg: str


@dataclass
class SignalProcess:
    signal_number: signal.Signals
    process_matcher: Callable[[Node], bool]


@dataclass
class EmitEvent:
    event: SignalProcess


@dataclass
class LaunchDescription:
    entities: list[Any]


@dataclass
class Node:
    package: str
    executable: str
    name: str = ''
    namespace: Any = ''
    parameters: list[Any] = field(default_factory=list)
    remappings: list[tuple[str, str]] = field(default_factory=list)
    arguments: list[Any] = field(default_factory=list)
    output: str = 'log'
    respawn: bool = False
    respawn_delay: float = 0.0
    additional_env: dict[str, str] = field(default_factory=dict)
    on_exit: Callable[[Any, LaunchContext], list[Any]] = lambda *_: []
    process_details: dict[str, Any] | None = None

    @property
    def node_package(self) -> str:
        return self.package

    def argv(self, context: LaunchContext, folder: Path) -> list[str]:
        """Return the command line of launch_ros."""
        argv = [str(executable(self.package, self.executable))]
        argv += [text(argument, context) for argument in self.arguments]
        argv += ['--ros-args', '-r', f'__node:={self.name}']
        if namespace := text(self.namespace, context):
            argv += ['-r', f'__ns:=/{namespace.strip("/")}']
        for name, target in self.remappings:
            argv += ['-r', f'{name}:={target}']
        for number, parameters in enumerate(self.parameters):
            argv += ['--params-file', _params_file(parameters, context, folder, number)]
        return argv


LifecycleNode = Node


class ProcessExited(SimpleNamespace):
    """Event with the `returncode` of a process."""


def text(value: Any, context: LaunchContext) -> str:
    """Return the text of a value or substitution."""
    return value.perform(context) if isinstance(value, Substitution) else str(value)


def _params_file(
    parameters: ParameterFile | dict[str, Any], context: LaunchContext, folder: Path, number: int
) -> str:
    if isinstance(parameters, ParameterFile):
        return text(parameters.param_file, context)
    own = {k: v.value if isinstance(v, ParameterValue) else v for k, v in parameters.items()}
    with tempfile.NamedTemporaryFile('w', dir=folder, suffix=f'_{number}', delete=False) as file:
        yaml.safe_dump({'/**': {'ros__parameters': own}}, file)
    return file.name


class Launched:
    """The process of a node, which is restarted if the node has `respawn`."""

    def __init__(self, node: Node, argv: list[str]) -> None:
        self.node, self._argv = node, argv
        self._start()
        self._due_s: float | None = None  # time of the restart; infinite: never

    def _start(self) -> None:
        self.process = subprocess.Popen(self._argv, env={**os.environ, **self.node.additional_env})
        self.node.process_details = {'pid': self.process.pid}

    def poll(self, context: LaunchContext) -> list[Any]:
        """Restart the process when due; return the actions that its end requests."""
        if self._due_s is not None:
            if time.monotonic() >= self._due_s:
                self._due_s = None
                self._start()
            return []
        if (status := self.process.poll()) is None or self._due_s == float('inf'):
            return []
        print_end(self.node.executable, status)
        self._due_s = (
            time.monotonic() + self.node.respawn_delay if self.node.respawn else float('inf')
        )
        return self.node.on_exit(ProcessExited(returncode=status), context)


def print_line(who: str, what: str) -> None:
    """Print a line as launch does."""
    sys.stdout.write(f'[{who}]: {what}\n')
    sys.stdout.flush()


def print_end(name: str, status: int) -> None:
    """Print how a process ended, in the words of launch."""
    print_line(name, f'process has died [exit code {status}]' if status else 'finished cleanly')


def run(nodes: list[Node], context: LaunchContext, folder: Path) -> None:
    """Run until SIGINT or until the end of a process requests a shutdown."""
    interrupts: list[int] = []
    signal.signal(signal.SIGINT, lambda sign, _frame: interrupts.append(sign))
    launched = [Launched(node, node.argv(context, folder)) for node in nodes]
    while not interrupts:
        for one in launched:
            for action in one.poll(context):
                if isinstance(action, EmitEvent):
                    send(action.event, launched)
                else:
                    is_end = isinstance(action, Shutdown)
                    print_line('launch', action.reason if is_end else action.msg)
                    interrupts += [0] * is_end
        time.sleep(_TICK_S)
    context.is_shutdown = True
    end([one for one in launched if one.process.poll() is None], context)


def send(event: SignalProcess, launched: list[Launched]) -> None:
    """Send a signal to the processes that an event selects."""
    for one in launched:
        if event.process_matcher(one.node):
            one.process.send_signal(event.signal_number)


def end(launched: list[Launched], context: LaunchContext) -> None:
    """End processes as launch does: SIGINT, then SIGTERM and SIGKILL to those that remain.

    A shutdown that `on_exit` requests now is an error of launch.
    """
    start_s = time.monotonic()
    stages = [
        (0.0, signal.SIGINT),
        (_SIGTERM_AFTER_S, signal.SIGTERM),
        (_SIGKILL_AFTER_S, signal.SIGKILL),
    ]
    while launched:
        if stages and time.monotonic() - start_s >= stages[0][0]:
            _, sign = stages.pop(0)
            for one in launched:
                one.process.send_signal(sign)
        for one in [one for one in launched if one.process.poll() is not None]:
            launched.remove(one)
            print_end(one.node.executable, one.process.returncode)
            if one.node.on_exit(ProcessExited(returncode=one.process.returncode), context):
                print_line('launch', 'Caught exception in launch')
        time.sleep(_TICK_S)


def description(path: Path) -> LaunchDescription:
    """Return the launch description of a launch file."""
    for name, members in NAMES.items():
        module = ModuleType(name)
        for member in members.split():
            setattr(module, member, globals()[member])
        sys.modules[name] = module
    made = runpy.run_path(str(path))['generate_launch_description']()
    assert isinstance(made, LaunchDescription)
    return made


def load(path: Path, arguments: list[str]) -> tuple[list[Node], LaunchContext]:
    """Return the nodes that a launch file starts with launch arguments, and the context."""
    pairs = [argument.partition(':=') for argument in arguments]
    context = LaunchContext({name: value for name, _, value in pairs})
    nodes: list[Node] = []
    for entity in description(path).entities:
        if isinstance(entity, DeclareLaunchArgument):
            entity.execute(context)
        else:
            nodes += entity.function(context)
    return nodes, context


def main() -> None:
    """Launch the file that the command line names."""
    path, *arguments = sys.argv[1:]
    nodes, context = load(Path(path), arguments)
    with tempfile.TemporaryDirectory() as folder:
        run(nodes, context, Path(folder))


if __name__ == '__main__':
    main()
