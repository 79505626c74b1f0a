"""Nodes as processes, started from their installed executables."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import psutil
import yaml

from hoid_bringup.live.node_specs import NODE_CONFIGS
from hoid_bringup.live.supervisor import ProcessSpec, Supervisor
from hoid_common.config import EXPERT

Start = Callable[..., Supervisor]
"""Fixture `start`: takes package, executable and parameters, returns the supervisor."""


def executable(package: str, name: str) -> Path:
    """Return an installed executable of a package in the sourced workspace."""
    for prefix in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep):
        path = Path(prefix) / 'lib' / package / name
        if path.is_file():
            return path
    raise FileNotFoundError(
        f'{package}/{name} is not installed; build the workspace and source it'
    )


def node_spec(
    package: str,
    name: str,
    params: Mapping[str, Any],
    ros_args: Sequence[str] = (),
) -> ProcessSpec:
    """Return the specification of `ros2 run package name` with user and expert parameters."""
    argv = [sys.executable, str(executable(package, name)), '--ros-args', *ros_args]
    for key, value in with_switch(package, params).items():
        text = yaml.safe_dump(value, default_flow_style=True).removesuffix('\n...\n').strip()
        argv += ['-p', f'{key}:={text}']
    return ProcessSpec(name, tuple(argv))


def with_switch(package: str, params: Mapping[str, Any]) -> dict[str, Any]:
    """Return a node's parameters, with the switch `expert` if one of them needs it."""
    config = NODE_CONFIGS.get(package)
    leaves = [] if config is None else config.node_params()
    needs_switch = any(leaf.spec.expert and leaf.name in params for leaf in leaves)
    return {EXPERT: True, **params} if needs_switch else dict(params)


def mapper_of(node: Supervisor) -> psutil.Process:
    """Return the mapper of a SLAM node: its only child."""
    (process,) = (
        worker
        for pid in node.pids.values()
        for server in psutil.Process(pid).children()
        for worker in server.children()
    )
    return process
