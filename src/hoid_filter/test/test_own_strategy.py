"""A strategy of another package, found by its entry point, without an edit of this package."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from hoid_common.errors import ConfigError
from hoid_filter.config import FilterConfig
from hoid_filter.strategy import FilterStrategy, make_strategy, needs_detections
from hoid_filter.strategy_registry import ENTRY_POINT_GROUP, STRATEGIES, load_strategy

EXAMPLE = Path(__file__).parents[3] / 'examples' / 'own_strategy'
PROGRAM = """
import numpy as np
from hoid_common.values import Detections
from hoid_filter.config import FilterConfig
from hoid_filter.strategy import FilterInput, make_strategy, needs_detections

boxes = np.array([[0, 0, 44, 120], [38, 40, 80, 60]], np.float32)  # they share little
found = Detections(0, boxes, ('person', 'cup'), np.ones(2, np.float32))
for depth_m in (2.1, 2.3):
    depth = np.full((120, 160), 2.0, np.float32)
    depth[30:70, 38:80] = depth_m
    config = FilterConfig(strategy='touching')
    verdict = make_strategy(config).classify(FilterInput(0, found, depth, np.arange(depth.size)))
    print(needs_detections(config), *(reason.name for reason in verdict.objects.reasons))
"""


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """Install the example as pip does: a folder of modules with their metadata."""
    project = tomllib.loads((EXAMPLE / 'pyproject.toml').read_text())['project']
    (target,) = project['entry-points'][ENTRY_POINT_GROUP].items()
    metadata = tmp_path / 'own_strategy-1.0.dist-info'
    metadata.mkdir()
    (metadata / 'METADATA').write_text('Metadata-Version: 2.1\nName: own-strategy\nVersion: 1.0\n')
    (metadata / 'entry_points.txt').write_text(f'[{ENTRY_POINT_GROUP}]\n{" = ".join(target)}\n')
    (tmp_path / 'own_strategy.py').write_text((EXAMPLE / 'own_strategy.py').read_text())
    return tmp_path


def test_a_strategy_of_another_package_is_found_by_its_entry_point(installed: Path) -> None:
    assert 'touching' not in STRATEGIES
    done = subprocess.run(
        [sys.executable, '-c', PROGRAM],
        env={'PYTHONPATH': ':'.join([str(installed), *sys.path])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ['True PERSON HANDLED', 'True PERSON AT_REST']


@pytest.mark.parametrize('name', STRATEGIES)
def test_each_strategy_has_the_interface(name: str) -> None:
    config = FilterConfig(strategy=name)
    strategy: FilterStrategy = make_strategy(config)
    assert (
        needs_detections(config) == strategy.needs_detections == (name not in ('none', 'motion'))
    )
    assert strategy.senses_motion == (name in ('motion', 'hoid+'))


def test_an_unknown_strategy_is_refused_with_the_known_names() -> None:
    with pytest.raises(
        ConfigError, match=r'no strategy is called "magic"; there are none, person'
    ):
        load_strategy('magic')
