import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from hoid_bringup.live.ros_domain import own_domain
from hoid_bringup.live.supervisor import Supervisor
from hoid_common.process.shared_memory import clean_shared_memory
from hoid_system_tests.filter_peer import FilterRunner, Peer
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start, node_spec
from hoid_system_tests.sample_bench import SampleBench

CACHE = Path.home() / '.cache'  # has downloaded models and the font cache of matplotlib
PROFILE = Path(__file__).parents[1] / 'src/hoid_common/config/fastdds_profile.xml'


@pytest.fixture(scope='session', autouse=True)
def _clean_machine() -> Iterator[None]:
    """Remove the shared memory that killed nodes left behind."""
    yield
    clean_shared_memory()


@pytest.fixture
def domain_id(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[int]:
    """The ROS domain of this test and of the processes that it starts.

    Their home folder, where nodes store maps and logs by default, is temporary.
    """
    monkeypatch.setenv('XDG_CACHE_HOME', os.environ.get('XDG_CACHE_HOME') or str(CACHE))
    monkeypatch.setenv('HOME', str(tmp_path_factory.mktemp('home')))
    monkeypatch.delenv('ROS_DOMAIN_ID', raising=False)
    with own_domain() as domain:
        monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(PROFILE))
        yield domain


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder in which a node saves its maps; its name has a space."""
    folder = tmp_path / 'my maps'
    folder.mkdir()
    return folder


@pytest.fixture
def probe(domain_id: int) -> Iterator[Probe]:
    node = Probe(domain_id)
    yield node
    node.close()


@pytest.fixture
def sample(domain_id: int) -> Iterator[SampleBench]:
    bench = SampleBench(domain_id)
    yield bench
    bench.close()


@pytest.fixture
def run_filter(probe: Probe, start: Start) -> FilterRunner:
    """Start hoid_filter with parameters and return its peer."""

    def run(**params: Any) -> Peer:
        peer = Peer(probe)
        start('hoid_filter', 'hoid_filter_node', {'strategy': 'hoid2d', **params})
        ignores_boxes = params.get('strategy') == 'motion' or params.get(
            'detections.as_vision_msgs'
        )
        peer.connect(waits_for_boxes=not ignores_boxes)
        return peer

    return run


@pytest.fixture
def start(domain_id: int, tmp_path: Path) -> Iterator[Start]:
    """Start nodes as processes: `start('package', 'executable', {'parameter': value})`."""
    assert os.environ['ROS_DOMAIN_ID'] == str(domain_id)  # which they inherit
    running: list[Supervisor] = []

    def start_node(
        package: str, name: str, params: Mapping[str, Any] | None = None, **kwargs: Any
    ) -> Supervisor:
        spec = node_spec(package, name, params or {}, **kwargs)
        supervisor = Supervisor([spec], log_dir=tmp_path / f'log_{len(running)}')
        running.append(supervisor.__enter__())
        return supervisor

    yield start_node
    for supervisor in running:
        supervisor.stop()
