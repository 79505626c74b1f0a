"""Command lines of the four nodes, with their parameters."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hoid_bringup.live.supervisor import ProcessSpec
from hoid_common.config import EXPERT, Config
from hoid_common.errors import ConfigError
from hoid_common.io.yaml_file import load_params
from hoid_common.process.signals import FAILURE_SIGNAL
from hoid_detector.config import DetectorNodeConfig
from hoid_filter.config import FilterNodeConfig
from hoid_scene.config.scene_config import SceneNodeConfig
from rgbd_slam.config.node_config import SlamNodeConfig

DETECTOR, FILTER, SLAM, SCENE = 'hoid_detector', 'hoid_filter', 'rgbd_slam', 'hoid_scene'
NODE_CONFIGS: Mapping[str, Config] = {
    DETECTOR: DetectorNodeConfig(),
    FILTER: FilterNodeConfig(),
    SLAM: SlamNodeConfig(),
    SCENE: SceneNodeConfig(),
}
"""Default configuration of each node."""
# The nodes run in the Python interpreter of this process. The installed executables would use the
# first interpreter on the path, which may be another one.
_START = ('env', '--block-signal=INT', sys.executable, '-c')
_CODE = "from hoid_common.process.entry import start; start('{package}.node')"


@dataclass(frozen=True)
class NodeOptions:
    """Options with which the nodes are started."""

    nodes: tuple[str, ...] = (DETECTOR, FILTER, SLAM, SCENE)
    namespace: str = ''
    use_sim_time: bool = False
    params_file: Path | None = None  # ROS parameter file for all nodes
    remappings: tuple[tuple[str, str], ...] = ()  # (from, to) of topics
    # By node and dotted name: values of parameters.
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def given(self, node: str) -> dict[str, Any]:
        """Return the parameters that the user has set for a node; empty if it is not started."""
        if node not in self.nodes:
            return {}
        from_file = load_params(self.params_file, node) if self.params_file else {}
        return {**from_file, **self.parameters.get(node, {})}


def node_specs(options: NodeOptions) -> tuple[ProcessSpec, ...]:
    """Return the command lines of the nodes; `parameters` override those in `params_file`.

    `parameters` are on the command lines, not in a temporary file, so that a node can be restarted
    even if temporary files were removed. If one is an expert parameter, `expert` is set for its
    node. ConfigError for an internal parameter, which exists in offline runs only.
    """
    return tuple(_spec(package, options) for package in options.nodes)


def _spec(package: str, options: NodeOptions) -> ProcessSpec:
    arguments = ['--ros-args', '--log-level', 'info']
    if options.namespace:
        arguments += ['-r', f'__ns:=/{options.namespace.strip("/")}']
    for name, target in options.remappings:
        arguments += ['-r', f'{name}:={target}']
    if options.params_file is not None:
        arguments += ['--params-file', str(options.params_file)]
    own = {**options.parameters.get(package, {}), 'use_sim_time': options.use_sim_time}
    given = [leaf for leaf in NODE_CONFIGS[package].params() if leaf.name in own]
    for leaf in given:
        if leaf.spec.is_internal:
            raise ConfigError(f'{leaf.name} is no parameter of a node; only offline runs set it')
    if any(leaf.spec.expert for leaf in given):
        own[EXPERT] = True
    arguments += parameter_arguments(own)
    argv = (*_START, _CODE.format(package=package), *arguments)
    return ProcessSpec(package, argv, failure_signal=FAILURE_SIGNAL)


def parameter_arguments(parameters: Mapping[str, Any]) -> list[str]:
    """Return the ROS arguments that set parameters for all nodes of a process.

    An empty tuple becomes [''], because ROS has no empty lists of strings.
    """
    arguments = []
    for name, value in parameters.items():
        entries = list(value or ('',)) if isinstance(value, tuple) else value
        # JSON, which is valid YAML, quotes each text; ROS would read an unquoted text 1e3 as a
        # number.
        arguments += ['-p', f'{name}:={json.dumps(entries, ensure_ascii=False)}']
    return arguments
