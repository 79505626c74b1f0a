"""Provenance of a result: command, version of the code, machine and detector."""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hoid_bringup.run.run_config import TRUTH, RunConfig
from hoid_common.errors import ModelError
from hoid_detector.model.model_path import find_model

_FILTER = 'filter'  # short name of a parameter that every summary has


@dataclass(frozen=True)
class DetectorFile:
    """The detector of a run."""

    name: str  # name of the file without suffix, or "truth"
    sha256: str | None  # digest of the file; None for ground-truth boxes


@dataclass(frozen=True)
class Provenance:
    """How a result was produced: command, version of the code, machine and detector."""

    command: str  # command line, quoted for a shell
    commit: str  # result of the function `commit` for the source tree
    machine: str  # processor, number of cores, memory and operating system
    detector: DetectorFile | None  # None: no detector was used, or its file is not found

    @classmethod
    def of_this_process(cls, options: Mapping[str, Any]) -> Provenance:
        here = Path(__file__).resolve().parent
        program = 'hoid' if Path(sys.argv[0]).name == '__main__.py' else sys.argv[0]
        command = shlex.join([program, *sys.argv[1:]])
        return cls(command, commit(here), machine(), _detector(options))


def machine() -> str:
    memory_gib = os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES') / 2**30
    return f'{_processor()}, {os.cpu_count()} cores, {memory_gib:.0f} GiB, {platform.system()}'


def commit(folder: Path) -> str:
    """Return the commit of a clone, with "-dirty" if files have changed; '' outside a clone."""
    command = ['git', '-C', str(folder), 'describe', '--always', '--dirty', '--exclude=*']
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return ''
    return done.stdout.strip()


def _processor() -> str:
    info = Path('/proc/cpuinfo')
    names = (
        line.split(':', 1)[1].strip()
        for line in (info.read_text().splitlines() if info.is_file() else ())
        if line.startswith('model name')
    )
    return next(names, platform.machine())


def _detector(options: Mapping[str, Any]) -> DetectorFile | None:
    config = RunConfig.from_summary_options(options)
    if _FILTER not in options or not config.needs_detections:
        return None
    if config.detector.model == TRUTH:
        return DetectorFile(TRUTH, None)
    with suppress(ModelError, OSError):  # replayed detections need no model file
        path = find_model(config.detector.model or None)
        return DetectorFile(path.stem, hashlib.sha256(path.read_bytes()).hexdigest())
    return None
