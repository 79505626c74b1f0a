"""Every parameter of every node through a real client: described, and changed or refused."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import Any

import pytest

from hoid_bringup.live.node_specs import NODE_CONFIGS
from hoid_common.config import EXPERT, Param
from hoid_system_tests.detector_bench import write_model
from hoid_system_tests.parameter_client import ParameterClient
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start

pytestmark = pytest.mark.thorough

GIVEN: dict[str, dict[str, Any]] = {
    'hoid_detector': {},
    'hoid_filter': {},
    'rgbd_slam': {},
    'hoid_scene': {},
}


def other_value(leaf: Param) -> Any:
    """Return a value within the range that is not the default."""
    value, spec = leaf.value, leaf.spec
    if isinstance(value, bool):
        return not value
    if spec.choices:
        return next(choice for choice in spec.choices if choice != value)
    if isinstance(value, tuple):
        return ['person']
    if isinstance(value, str):
        return 'other'
    low, high = spec.limits
    low, high = low if isfinite(low) else value - 2, high if isfinite(high) else value + 2
    middle = (value + (high if high > value else low)) / 2
    return type(value)(middle) if type(value)(middle) != value else type(value)(high)


@pytest.fixture(params=NODE_CONFIGS)
def client(
    request: pytest.FixtureRequest, start: Start, probe: Probe, tmp_path: Path
) -> ParameterClient:
    node: str = request.param
    given = dict(GIVEN[node])
    if node == 'hoid_detector':
        given['model'] = str(write_model(tmp_path / 'model.onnx'))
    start(node, f'{node}_node', {**given, EXPERT: True})
    return ParameterClient(probe, node)


def test_each_parameter_is_described_and_changes_or_is_refused(
    client: ParameterClient, request: pytest.FixtureRequest
) -> None:
    node = request.node.callspec.params['client']
    leaves = {leaf.name: leaf for leaf in NODE_CONFIGS[node].node_params()}
    assert leaves.keys() <= set(client.names())
    for leaf, descriptor in zip(leaves.values(), client.describe(list(leaves)), strict=True):
        check_description(leaf, descriptor)
    fixed = {name: leaf for name, leaf in leaves.items() if leaf.spec.read_only}
    before = client.get(list(fixed))
    for result in client.set({name: other_value(leaf) for name, leaf in fixed.items()}):
        assert not result.successful
        assert 'read-only' in result.reason
    assert client.get(list(fixed)) == before
    free = {name: leaf for name, leaf in leaves.items() if not leaf.spec.read_only}
    for name, leaf in free.items():
        check_change(client, name, leaf)
    for name, leaf in leaves.items():
        if isinstance(leaf.value, tuple):
            check_no_list(client, name)


def check_description(leaf: Param, descriptor: Any) -> None:
    assert descriptor.name == leaf.name
    assert descriptor.description == leaf.spec.description
    assert descriptor.description
    assert descriptor.read_only == leaf.spec.read_only
    for limits in (*descriptor.floating_point_range, *descriptor.integer_range):
        low, high = leaf.spec.limits
        assert limits.from_value == low
        if isfinite(high):
            assert limits.to_value == high
    for choice in leaf.spec.choices:
        assert choice in descriptor.additional_constraints


def check_change(client: ParameterClient, name: str, leaf: Param) -> None:
    before, after = client.get([name])[0], other_value(leaf)
    (result,) = client.set({name: after})
    assert result.successful, (name, result.reason)
    assert client.get([name]) == [after]
    if isfinite(high := leaf.spec.limits[1]):
        (result,) = client.set({name: type(leaf.value)(high + 1)})
        assert not result.successful, name
        assert name.rsplit('.', 1)[-1] in result.reason
        assert client.get([name]) == [after]
    client.set({name: before if before else after})


def check_no_list(client: ParameterClient, name: str) -> None:
    """Check that values of other types than a list of names are refused."""
    before = client.get([name])
    for value in (5, 0.5, True, 'person', [b'p'], [1, 2], [True], None):  # None deletes it
        (result,) = client.set({name: value})
        assert not result.successful, (name, value)
        assert len(result.reason.splitlines()) == 1
        assert client.get([name]) == before
