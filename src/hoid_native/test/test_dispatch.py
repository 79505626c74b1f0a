"""Kernels compiled for newer processors return the same bits as those compiled for any processor.

The build makes a second module that has only the latter (`HOID_ONE_VERSION`).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import hoid_native

DIGESTS = Path(__file__).parent / 'digests.py'
HERE = Path(__file__).parents[3]
DEFAULT = HERE / 'build' / 'hoid_native' / 'one_version'


def digests(*arguments: str) -> dict[str, str]:
    done = subprocess.run(
        [sys.executable, DIGESTS, *arguments], check=True, capture_output=True, text=True
    )
    found: dict[str, str] = json.loads(done.stdout.splitlines()[-1])
    return found


def test_all_versions_of_every_kernel_return_the_same_bits() -> None:
    for_any = digests(os.environ.get('HOID_ONE_VERSION_FOLDER', str(DEFAULT)))
    here = digests()
    assert here == for_any
    functions = {name for name in hoid_native.__all__ if name.islower()}
    assert {name.split()[0] for name in here} == functions - {'are_boxes_valid'}
