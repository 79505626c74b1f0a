from pathlib import Path

import pytest

from hoid_common.errors import InputError
from hoid_common.process.shared_memory import check_shared_memory, missing_shared_memory

PROFILE = Path(__file__).parents[1] / 'config/fastdds_profile.xml'
MANY = 10**9


@pytest.fixture(autouse=True)
def _profile(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv('RMW_IMPLEMENTATION', raising=False)
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(PROFILE))


def test_more_processes_than_fit_are_refused() -> None:
    with pytest.raises(InputError, match=r'\d+ MB free, and 10+ processes take 34 MB each'):
        check_shared_memory(MANY)
    check_shared_memory(0)


def test_a_process_without_a_segment_says_what_to_do() -> None:
    assert '--shm-size' in missing_shared_memory()  # as nothing of ROS runs here


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('RMW_IMPLEMENTATION', 'rmw_cyclonedds_cpp'),
        ('FASTRTPS_DEFAULT_PROFILES_FILE', '/nowhere'),
    ],
)
def test_who_asks_for_none_gets_no_complaint(
    name: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(name, value)
    check_shared_memory(MANY)
    assert missing_shared_memory() == ''
