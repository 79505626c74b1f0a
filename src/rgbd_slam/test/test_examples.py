"""The examples of a place index and of a sensor work without a change of this package."""

from __future__ import annotations

import importlib.util
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.slam_status import SlamState
from hoid_common.values import S_PER_NS, ByteArray, FloatArray
from rgbd_slam.config.place_config import IndexConfig, PlaceConfig
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.places.place_index import (
    ENTRY_POINT_GROUP,
    PLACE_INDICES,
    PlaceVotes,
    make_place_index,
)
from rgbd_slam.slam import RgbdSlam
from rgbd_slam.tracking.motion_sources import ExternalOdometry

from .world import CAMERA, PERIOD_NS, World

EXAMPLES = Path(__file__).parents[3] / 'examples'
TURN: FloatArray = np.array([0.0, 0.6, 0.0])  # rad within one period
TURNED = se3.exp(np.concatenate([TURN, np.zeros(3)]))


@pytest.fixture
def installed_index(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install the example as pip does: create a folder with its module and metadata."""
    example = EXAMPLES / 'own_place_index'
    project = tomllib.loads((example / 'pyproject.toml').read_text())['project']
    (target,) = project['entry-points'][ENTRY_POINT_GROUP].items()
    metadata = tmp_path / 'own_place_index-1.0.dist-info'
    metadata.mkdir()
    (metadata / 'METADATA').write_text(
        f'Metadata-Version: 2.1\nName: {project["name"]}\nVersion: {project["version"]}\n'
    )
    (metadata / 'entry_points.txt').write_text(f'[{ENTRY_POINT_GROUP}]\n{" = ".join(target)}\n')
    (tmp_path / 'own_place_index.py').write_text((example / 'own_place_index.py').read_text())
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, 'own_place_index', raising=False)


@pytest.mark.usefixtures('installed_index')
def test_a_place_index_of_another_package_is_found_by_its_entry_point() -> None:
    assert 'exhaustive' not in PLACE_INDICES
    index = make_place_index('exhaustive', IndexConfig())
    assert type(index).__module__ == 'own_place_index'


@pytest.mark.usefixtures('installed_index')
def test_the_place_index_of_another_package_relocalizes_the_camera(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    index_class = type(make_place_index('exhaustive', IndexConfig()))
    answers = []

    def query(index: Any, descriptors: ByteArray) -> PlaceVotes:
        answers.append(original_query(index, descriptors))
        return answers[-1]

    original_query = index_class.query
    monkeypatch.setattr(index_class, 'query', query)
    config = SlamConfig(places=PlaceConfig(index=IndexConfig(method='exhaustive')))
    slam, world = RgbdSlam(CAMERA, config), World()
    for n, T_world_camera in enumerate([np.eye(4)] * 3 + [TURNED]):
        result = slam.process(world.features(n * PERIOD_NS, T_world_camera))
    assert result.T_map_camera is not None
    np.testing.assert_allclose(result.T_map_camera, TURNED, atol=0.01)
    assert slam.stats.num_relocalizations == 1
    assert answers[0].uids.tolist() == [0]
    assert answers[0].votes[0] > 100


def gyroscope() -> Any:
    spec = importlib.util.spec_from_file_location('gyroscope', EXAMPLES / 'gyroscope.py')
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.Gyroscope()


@pytest.mark.parametrize('has_gyroscope', [False, True])
def test_a_gyroscope_predicts_a_turn_that_otherwise_needs_relocalization(
    has_gyroscope: bool,
) -> None:
    sensor, world = gyroscope(), World()
    sources = [ExternalOdometry(sensor.motion)] if has_gyroscope else []
    slam = RgbdSlam(CAMERA, SlamConfig(), motion_sources=sources)
    for n, T_world_camera in enumerate([np.eye(4)] * 3 + [TURNED]):
        velocity_radps = TURN / (S_PER_NS * PERIOD_NS) if T_world_camera is TURNED else np.zeros(3)
        sensor.add(n * PERIOD_NS, velocity_radps)
        result = slam.process(world.features(n * PERIOD_NS, T_world_camera))
        assert result.state is SlamState.TRACKING
    assert slam.stats.num_relocalizations == (0 if has_gyroscope else 1)


def test_the_motion_of_a_gyroscope_is_unknown_outside_of_its_stamps() -> None:
    sensor = gyroscope()
    for n in range(3):
        sensor.add(n * PERIOD_NS, TURN)
    expected = se3.exp(np.concatenate([TURN * S_PER_NS * PERIOD_NS, np.zeros(3)]))
    np.testing.assert_allclose(sensor.motion(PERIOD_NS, 2 * PERIOD_NS), expected, atol=1e-12)
    assert sensor.motion(PERIOD_NS, 10 * PERIOD_NS) is None
