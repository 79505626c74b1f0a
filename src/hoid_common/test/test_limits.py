"""A limit of open files that is too low is raised, or named in one line."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest

CODE = """
import resource, sys
from hoid_common.process.limits import require_descriptors
resource.setrlimit(resource.RLIMIT_NOFILE, (int(sys.argv[1]), int(sys.argv[2])))
try:
    require_descriptors()
    print(resource.getrlimit(resource.RLIMIT_NOFILE)[0])
except Exception as error:
    print(type(error).__name__, error)
"""


def limited(soft: int, hard: int) -> str:
    """Return what a process with limits of open files prints."""
    argv = [sys.executable, '-c', CODE, str(soft), str(hard)]
    return subprocess.run(argv, capture_output=True, text=True, timeout=60, check=True).stdout


@pytest.mark.parametrize(('soft', 'hard', 'then'), [(40, 1024, 256), (700, 1024, 700)])
def test_a_limit_that_may_be_raised_is_raised(soft: int, hard: int, then: int) -> None:
    assert limited(soft, hard) == f'{then}\n'


def test_a_limit_that_must_not_be_raised_is_named() -> None:
    said = limited(40, 40)
    assert said.startswith('ConfigError this process may have 40 files open at once and needs 256')
    assert '"ulimit -n 1024" in the shell' in said
    assert said.count('\n') == 1
    assert resource.getrlimit(resource.RLIMIT_NOFILE)[0] > 256
