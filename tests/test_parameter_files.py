"""Every parameter file that is shipped, against the parameters that the nodes declare."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from hoid_common.config import Config
from hoid_common.io.param_file import load_params
from hoid_detector.node import NodeConfig as DetectorNodeConfig
from hoid_filter.node import NodeConfig as FilterNodeConfig
from rgbd_slam.config.node_config import SlamNodeConfig

FILES = sorted((Path(__file__).parents[1] / 'src').glob('*/config/*.yaml'))
DEFAULTS: dict[str, Config] = {
    'hoid_detector': DetectorNodeConfig(),
    'hoid_filter': FilterNodeConfig(),
    'rgbd_slam': SlamNodeConfig(),
}


def nodes_in(path: Path) -> list[str]:
    sections = yaml.safe_load(path.read_text())
    return [str(section).removeprefix('/**/') for section in sections]


def test_each_node_has_a_file_and_the_suite_one_for_all() -> None:
    files = {path.name: nodes_in(path) for path in FILES}
    assert files.pop('hoid.yaml') == list(DEFAULTS)
    assert files == {f'{name}.yaml': [name] for name in DEFAULTS}


@pytest.mark.parametrize(
    ('path', 'node'),
    [pytest.param(p, n, id=f'{p.stem}-{n}') for p in FILES for n in nodes_in(p)],
)
def test_shipped_values_are_known_valid_and_the_defaults(path: Path, node: str) -> None:
    values = load_params(path, node)
    assert values
    assert DEFAULTS[node].updated(values) == DEFAULTS[node]
