"""`ros2 param list`, `dump` and `set` on each node, started as users start them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from hoid_bringup.live.node_specs import NODE_CONFIGS
from hoid_bringup.live.supervisor import Supervisor
from hoid_common.config import EXPERT
from hoid_common.io.yaml_file import load_params
from hoid_system_tests.detector_bench import write_model
from hoid_system_tests.parameter_client import ParameterClient
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start

pytestmark = pytest.mark.thorough

OF_ROS = {'use_sim_time', 'start_type_description_service'}
# User parameters of each node, including integers for doubles and empty lists.
CHOSEN: dict[str, dict[str, Any]] = {
    'hoid_detector': {'score_threshold': 1, 'threads': 2, 'classes': ['']},
    'hoid_filter': {'depth_limit_m': 1, 'dynamic_classes': [''], 'strategy': 'none'},
    'rgbd_slam': {'map_file': '', 'frames.planar': True},
    'hoid_scene': {'dense.grid.max_height_m': 2, 'objects.enabled': False},
}
FOR_EXPERTS: dict[str, dict[str, Any]] = {
    'hoid_detector': {'nms_iou': 0.7, 'input_size_px': 320},
    'hoid_filter': {'detections.wait_s': 1, 'plus.remember': False},
    'rgbd_slam': {'camera.disparity_noise_px': 1, 'places.loops.enabled': False},
    'hoid_scene': {'dense.rate_hz': 1, 'dense.voxel_m': 0.05},
}
Launch = Callable[..., ParameterClient]


@pytest.fixture(params=NODE_CONFIGS)
def node(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture
def launch(node: str, start: Start, probe: Probe, tmp_path: Path) -> Launch:
    running: list[Supervisor] = []

    def launched(given: dict[str, Any], *arguments: str) -> ParameterClient:
        for before in running:  # nodes of the same name
            before.stop()
        if node == 'hoid_detector' and not arguments:
            given = {**given, 'model': str(write_model(tmp_path / 'model.onnx'))}
        running.append(start(node, f'{node}_node', given, ros_args=arguments))
        return ParameterClient(probe, node)

    return launched


def names_of(node: str, *, expert: bool) -> set[str]:
    leaves = NODE_CONFIGS[node].node_params()
    return {leaf.name for leaf in leaves if expert or not leaf.spec.expert}


def dumped(client: ParameterClient, node: str, path: Path) -> Path:
    """Write the file of `ros2 param dump`: a tree of names, with PyYAML's defaults."""
    names = sorted(client.names())
    tree: dict[str, Any] = {}
    for name, value in zip(names, client.get(names), strict=True):
        *above, leaf = name.split('.')
        branch = tree
        for part in above:
            branch = branch.setdefault(part, {})
        branch[leaf] = value
    path.write_text(yaml.dump({f'/{node}': {'ros__parameters': tree}}, default_flow_style=False))
    return path


def test_only_user_parameters_are_declared_by_default(node: str, launch: Launch) -> None:
    client = launch(CHOSEN[node])
    assert set(client.names()) - OF_ROS == names_of(node, expert=False)
    assert len(set(client.names()) - OF_ROS) <= 12
    (hidden,) = list(FOR_EXPERTS[node])[:1]
    (result,) = client.set({hidden: FOR_EXPERTS[node][hidden]})
    assert not result.successful
    assert 'undeclared' in result.reason


def test_expert_parameters_without_the_switch_are_reported(
    node: str, launch: Launch, tmp_path: Path
) -> None:
    client = launch({**FOR_EXPERTS[node], 'speling': 1, EXPERT: False})
    assert set(client.names()) - OF_ROS == names_of(node, expert=False)
    log = ''.join(path.read_text() for path in (tmp_path / 'log_0').iterdir())
    hidden = ', '.join(sorted(FOR_EXPERTS[node]))
    assert f'expert parameters have no effect unless expert:=true is set: {hidden}\n' in log
    assert 'no parameter is called "speling", it has no effect\n' in log


@pytest.mark.parametrize('expert', [False, True])
def test_a_dump_starts_the_same_node(
    node: str, launch: Launch, tmp_path: Path, expert: bool
) -> None:
    given = {**CHOSEN[node], EXPERT: expert, 'use_sim_time': expert}
    if expert:
        given |= FOR_EXPERTS[node]
    client = launch(given)
    names = sorted(client.names())
    assert set(names) - OF_ROS == names_of(node, expert=expert)
    before = client.get(names)
    for name, value in given.items():
        found = before[names.index(name)]
        assert found == value
        assert isinstance(found, bool) == isinstance(value, bool)
    path = dumped(client, node, tmp_path / 'dump.yaml')
    values = load_params(path, node)
    for name in OF_ROS:
        values.pop(name, None)
    assert NODE_CONFIGS[node].updated(values) != NODE_CONFIGS[node]
    again = launch({}, '--params-file', str(path))
    assert sorted(again.names()) == names
    assert again.get(names) == before
    assert [type(value) for value in again.get(names)] == [type(value) for value in before]


def test_whole_numbers_and_empty_lists_are_accepted_at_run_time(node: str, launch: Launch) -> None:
    name, value, kept = {
        'hoid_detector': ('score_threshold', 1, 1.0),
        'hoid_filter': ('depth_limit_m', 1, 1.0),
        'rgbd_slam': ('map_period_s', 3, 3.0),
        'hoid_scene': ('dense.grid.max_height_m', 3, 3.0),
    }[node]
    client = launch({'expert': node == 'rgbd_slam'})  # whose only user parameters are no numbers
    (result,) = client.set({name: value})
    assert result.successful, result.reason
    (found,) = client.get([name])
    assert (found, type(found)) == (kept, float)
    if node == 'hoid_detector':
        for empty in ([], ['']):
            assert client.set({'classes': ['person']})[0].successful
            assert client.set({'classes': empty})[0].successful
            assert client.get(['classes']) == [['']]
