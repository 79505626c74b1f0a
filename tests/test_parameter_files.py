"""Every shipped parameter file agrees with the parameters that the nodes declare."""

from __future__ import annotations

from pathlib import Path

import pytest

from hoid_bringup.live.node_specs import NODE_CONFIGS
from hoid_common.io.yaml_file import load_params, read_yaml

FILES = sorted((Path(__file__).parents[1] / 'src').glob('*/config/*.yaml'))


def nodes_in(path: Path) -> list[str]:
    return [str(section).removeprefix('/**/') for section in read_yaml(path)]


def test_each_node_has_a_file_and_the_suite_one_for_all() -> None:
    files = {path.name: nodes_in(path) for path in FILES}
    assert files.pop('hoid.yaml') == list(NODE_CONFIGS)
    assert files == {f'{name}.yaml': [name] for name in NODE_CONFIGS}


@pytest.mark.parametrize(
    ('path', 'node'),
    [pytest.param(p, n, id=f'{p.stem}-{n}') for p in FILES for n in nodes_in(p)],
)
def test_shipped_values_are_the_defaults_of_user_parameters(path: Path, node: str) -> None:
    values = load_params(path, node)
    users = {leaf.name for leaf in NODE_CONFIGS[node].node_params() if not leaf.spec.expert}
    assert values
    assert values.keys() <= users
    assert NODE_CONFIGS[node].updated(values) == NODE_CONFIGS[node]


@pytest.mark.parametrize('node', NODE_CONFIGS)
def test_the_file_of_a_node_lists_all_its_user_parameters(node: str) -> None:
    (path,) = (path for path in FILES if path.stem == node)
    users = {leaf.name for leaf in NODE_CONFIGS[node].node_params() if not leaf.spec.expert}
    # The default of `dynamic_classes` is a list of thirty names, which the file leaves out.
    assert users - load_params(path, node).keys() <= {'dynamic_classes'}
