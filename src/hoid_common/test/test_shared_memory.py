from pathlib import Path

import pytest

from hoid_common.errors import InputError
from hoid_common.process.shared_memory import check_shared_memory, shared_memory_problem

PROFILE = Path(__file__).parents[1] / 'config/fastdds_profile.xml'
MANY = 10**9


@pytest.fixture(autouse=True)
def _profile(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv('RMW_IMPLEMENTATION', raising=False)
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(PROFILE))


def test_too_little_shared_memory_is_an_error() -> None:
    with pytest.raises(InputError, match=r'\d+ MB free, but 10+ processes need 34 MB each'):
        check_shared_memory(MANY)
    check_shared_memory(0)


def test_a_process_without_a_segment_has_a_problem_text() -> None:
    assert '--shm-size' in shared_memory_problem()  # no ROS context exists here


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp'),
        ('FASTRTPS_DEFAULT_PROFILES_FILE', '/nowhere'),
    ],
)
def test_without_a_configured_segment_there_is_no_problem(
    name: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(name, value)
    check_shared_memory(MANY)
    assert shared_memory_problem() == ''
