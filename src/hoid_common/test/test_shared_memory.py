import os
from pathlib import Path

import pytest

from hoid_common.errors import InputError
from hoid_common.process.shared_memory import (
    check_shared_memory,
    full_profile,
    reduce_own_segment,
    shared_memory_problem,
)

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


@pytest.mark.parametrize('name', ['fastdds_profile.xml', 'fastdds_network_profile.xml'])
def test_a_node_has_a_smaller_segment_than_a_camera(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    profile = PROFILE.with_name(name)
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(profile))
    monkeypatch.setenv('HOID_FULL_PROFILES_FILE', '')
    reduce_own_segment()
    path = Path(os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'])
    assert path.resolve().is_file()  # Fast DDS resolves the path before it reads the file
    given = path.read_text()
    assert given == profile.read_text().replace('>33554432<', '>8388608<')
    assert full_profile() == str(profile)  # for the publishers of images


def test_a_profile_of_the_user_is_left_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tmp_path / 'profile.xml'
    other.write_text(PROFILE.read_text().replace('"hoid"', '"mine"'))
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', str(other))
    reduce_own_segment()
    assert os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] == full_profile() == str(other)
