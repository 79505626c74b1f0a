"""A limit of files or memory that is too low is raised, or named in one line."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest

CODE = """
import resource, sys
from hoid_common.process.limits import require_node_limits
kind = getattr(resource, sys.argv[3])
resource.setrlimit(kind, (int(sys.argv[1]), int(sys.argv[2])))
try:
    require_node_limits()
    print(resource.getrlimit(kind)[0])
except Exception as error:
    print(type(error).__name__, error)
"""


def limited(soft: int, hard: int, kind: str = 'RLIMIT_NOFILE') -> str:
    """Return what a process with a limit prints."""
    argv = [sys.executable, '-c', CODE, str(soft), str(hard), kind]
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


@pytest.mark.parametrize(
    ('kind', 'limit', 'line'),
    [
        ('RLIMIT_AS', 1000 << 20, 'have 1000 MB of address space and needs 3000'),
        ('RLIMIT_FSIZE', 1 << 20, 'write files of 1 MB, also for images in shared memory, and'),
    ],
)
def test_limits_of_memory_and_of_files(kind: str, limit: int, line: str) -> None:
    assert limited(limit, -1, kind) == '-1\n'
    assert limited(1 << 32, 1 << 32, kind) == f'{1 << 32}\n'
    assert limited(limit, limit, kind).startswith(f'ConfigError this process may {line}')
