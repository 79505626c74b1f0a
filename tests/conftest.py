import itertools
import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import domain_coordinator
import pytest

from hoid_bringup.supervisor import Supervisor, clean_shared_memory
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import node_spec

PROFILE = Path(__file__).parents[1] / 'src/hoid_common/config/fastdds_profile.xml'


@pytest.fixture(scope='session', autouse=True)
def _clean_machine() -> Iterator[None]:
    """Remove what nodes that had to be killed left in shared memory."""
    yield
    clean_shared_memory()


@pytest.fixture
def domain_id(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A domain of the test's own, for processes that it starts as well."""
    start = itertools.count(random.randrange(100))
    # A random start: who runs something by hand tends to take a low number.
    with domain_coordinator.domain_id(lambda: next(start) % 100 + 1) as domain:
        monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
        monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(PROFILE))
        yield domain


@pytest.fixture
def probe(domain_id: int) -> Iterator[Probe]:
    node = Probe(domain_id)
    yield node
    node.close()


@pytest.fixture
def start(domain_id: int, tmp_path: Path) -> Iterator[Callable[..., Supervisor]]:
    """Start nodes as processes: `start('package', 'executable', {'parameter': value})`."""
    running: list[Supervisor] = []

    def start_node(
        package: str, name: str, params: Mapping[str, Any] | None = None, **kwargs: Any
    ) -> Supervisor:
        env = {'ROS_DOMAIN_ID': str(domain_id)}
        spec = replace(node_spec(package, name, params or {}, **kwargs), env=env)
        supervisor = Supervisor([spec], log_dir=tmp_path / f'log_{len(running)}')
        running.append(supervisor.__enter__())
        return supervisor

    yield start_node
    for supervisor in running:
        supervisor.stop()
