"""Kernels compiled for newer processors return the same bits as those compiled for any processor.

The target `one_version` of the build is a second module that has only the latter.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from hoid_native import _native

DIGESTS = Path(__file__).parent / 'digests.py'
BUILD = Path(
    os.environ.get('HOID_NATIVE_BUILD', Path(__file__).parents[3] / 'build' / 'hoid_native')
)


def digests(*arguments: str) -> dict[str, str]:
    done = subprocess.run(
        [sys.executable, DIGESTS, *arguments], check=True, capture_output=True, text=True
    )
    found: dict[str, str] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.slow  # compiles the kernels, once after each change
def test_all_versions_of_every_kernel_return_the_same_bits() -> None:
    build = ['cmake', '--build', str(BUILD), '--target', 'one_version']
    subprocess.run(build, check=True, capture_output=True)
    for_any = digests(str(BUILD / 'one_version'))
    here = digests()
    assert here == for_any
    functions = {name for name in dir(_native) if name.islower() and name[0] != '_'}
    assert {name.split()[0] for name in here} == functions
