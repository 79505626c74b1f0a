"""The launch files with stand-ins for ROS's launch packages, which the wheels lack."""

from __future__ import annotations

import json
import re
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import MagicMock

import pytest
import yaml

from hoid_bringup.live.camera_topics import CAMERA_TOPICS
from hoid_common import topics
from hoid_common.topics import NAMESPACED_TF

SRC = Path(__file__).parents[2]
MODULES = """launch launch.actions launch.conditions launch.substitutions launch_ros
    launch_ros.actions launch_ros.parameter_descriptions launch_ros.substitutions"""


ARRIVING = {
    'rgb/image', 'rgb/image/compressed', 'depth/image', 'depth/image/compressedDepth',
    'rgb/camera_info',
}  # fmt: skip
HEARD = {
    'hoid_detector': {'rgb/image', 'rgb/image/compressed'},
    'hoid_filter': ARRIVING,
    'rgbd_slam': ARRIVING,
}
SHOWN = {
    topics.DETECTIONS, topics.FEATURES, topics.DYNAMIC_OBJECTS, topics.ODOM, topics.PATH,
    topics.MAP_POINTS, topics.CLOUD_MAP, topics.GRID_MAP, topics.KEYFRAMES, topics.SLAM_STATUS,
    topics.TRACKED_OBJECTS, topics.TRACKED_OBJECT_MARKERS,
    topics.DEBUG_IMAGE.replace('~', 'hoid_filter'),
    topics.DEBUG_IMAGE.replace('~', 'hoid_detector'),
}  # fmt: skip
OWN = sorted(p for p in SRC.glob('*/launch/*.launch.py') if p.parts[-3] != 'hoid_bringup')


class Action:
    """Keeps what an action or substitution was made with."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.args, self.kwargs = args, kwargs

    def perform(self, _context: object) -> str:
        return 'realsense' if self.args == ('camera',) else ''


def load(path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the entities of a launch description."""
    for name in MODULES.split():
        module = ModuleType(name)
        module.__getattr__ = lambda _name: Action  # type: ignore[method-assign]
        monkeypatch.setitem(sys.modules, name, module)
    description = runpy.run_path(str(path))['generate_launch_description']()
    return list(description.args[0])


def test_the_suite_starts_three_nodes_with_the_cameras_topics(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    *arguments, setup = load(SRC / 'hoid_bringup/launch/hoid.launch.py', monkeypatch)
    nodes = setup.kwargs['function'](MagicMock())
    packages = [node.kwargs['package'] for node in nodes]
    assert packages == ['hoid_detector', 'hoid_filter', 'rgbd_slam', 'rviz2']
    for node in nodes[:3]:
        assert node.kwargs['executable'] == f'{node.kwargs["package"]}_node'
        remappings = dict(node.kwargs['remappings'])
        assert remappings.items() >= dict(CAMERA_TOPICS['realsense'].remappings()).items()
        assert remappings.items() >= dict(NAMESPACED_TF).items()
    declared = {argument.args[0] for argument in arguments}
    assert {'namespace', 'params_file', 'camera', 'use_sim_time', 'base_frame'} <= declared


@pytest.mark.parametrize('name', CAMERA_TOPICS)
def test_a_camera_renames_raw_and_compressed_alike(name: str) -> None:
    names = dict(CAMERA_TOPICS[name].remappings())
    assert names['rgb/image/compressed'] == f'{names["rgb/image"]}/compressed'
    assert names['depth/image/compressedDepth'] == f'{names["depth/image"]}/compressedDepth'
    assert names.keys() == ARRIVING


@pytest.mark.parametrize('path', OWN, ids=lambda p: p.name)
def test_a_nodes_own_launch_file(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = path.parents[1].name
    *arguments, node = load(path, monkeypatch)
    assert node.kwargs['package'] == package
    assert node.kwargs['executable'] == f'{package}_node'
    renamed = {name for name, _ in node.kwargs['remappings']}
    assert renamed - {'/tf', '/tf_static'} == HEARD[package]
    declared = {argument.args[0] for argument in arguments}
    assert {'namespace', 'params_file', 'use_sim_time', 'image'} <= declared


def test_rviz_shows_only_what_is_published() -> None:
    document = yaml.safe_load((SRC / 'hoid_bringup/rviz/hoid.rviz').read_text())
    shown = document['Visualization Manager']['Displays']
    names = {display['Topic']['Value'] for display in shown if 'Topic' in display}
    assert len(names) >= 8
    assert names <= SHOWN


def test_foxglove_shows_only_what_is_published() -> None:
    layout = json.loads((SRC / 'hoid_bringup/foxglove/hoid.json').read_text())
    names = set(re.findall(r'"(/[a-z][\w/]*)', json.dumps(layout)))
    assert len(names) >= 10
    assert {name.lstrip('/') for name in names} <= SHOWN | {'diagnostics'}
    assert set(panels(layout['layout'])) == layout['configById'].keys()


def panels(node: str | dict[str, Any]) -> Iterator[str]:
    """Yield the panels of a Foxglove layout, whose branches split the window in two."""
    if isinstance(node, str):
        yield node
        return
    for side in ('first', 'second'):
        yield from panels(node[side])
