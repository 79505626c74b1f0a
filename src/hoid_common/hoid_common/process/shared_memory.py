"""Checks of the shared memory through which Fast DDS transports images.

Fast DDS allocates one segment in /dev/shm for each process. If it cannot, most images are lost.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from hoid_common.errors import InputError

PROFILE_VARIABLE = 'FASTRTPS_DEFAULT_PROFILES_FILE'
"""Environment variable with the path of the profile of Fast DDS."""
# Environment variable: path of the profile that `reduce_own_segment` has replaced.
_FULL_PROFILE = 'HOID_FULL_PROFILES_FILE'
_FOLDER = '/dev/shm'  # noqa: S108 - Fast DDS's own choice
_SEGMENT_SIZE = re.compile(
    r'(<type>SHM</type>(?:(?!</transport_descriptor>).)*?<segment_size>)\s*(\d+)', re.DOTALL
)
_OWN_PROFILE = 'profile_name="hoid"'  # text that identifies a profile of the suite
# Chosen: the features of three seconds at 30 Hz. A segment of 32 MiB, which images of a camera
# need, keeps 33 MB resident in each node; one of 8 MiB at most 5 MB. A larger message is sent in
# parts: a cloud of 24 MB arrives as fast as before (decision 017).
_NODE_SEGMENT_BYTES = 8 << 20
_LOCK_FILE = re.compile(rf'{_FOLDER}/fastrtps_[0-9a-f]+_el')
_FILE_SIZE_RATIO = 1.06  # measured: size of a segment's file / configured segment size
_BYTES_PER_MB = 2**20
_REMEDY = 'a container needs --shm-size=1g or --ipc=host'


def uses_fast_dds() -> bool:
    """Return whether the ROS middleware is Fast DDS, the default of Jazzy."""
    return 'fastrtps' in os.environ.get('RMW_IMPLEMENTATION', 'rmw_fastrtps_cpp')


def check_shared_memory(num_processes: int) -> None:
    """Raise InputError if /dev/shm, cleaned if necessary, lacks space for `num_processes`."""
    each_mb = _FILE_SIZE_RATIO * _segment_mb()
    if _free_mb() < num_processes * each_mb:
        clean_shared_memory()
    if _free_mb() < num_processes * each_mb:
        raise InputError(
            f'{_FOLDER} has {_free_mb():.0f} MB free, but {num_processes} processes need '
            f'{each_mb:.0f} MB each, or images get lost; {_REMEDY}'
        )


def reduce_own_segment() -> None:
    """Let Fast DDS allocate 8 MiB in this process, which sends no stream of images.

    Call this before ROS is initialized. Only profiles of the suite are changed: the environment
    variable then names a temporary copy, which exists as long as the process. The copy needs a
    name, because Fast DDS resolves the path. If it cannot be written, nothing is changed.
    """
    text = _profile_text()
    if _OWN_PROFILE not in text or _segment_mb() * _BYTES_PER_MB <= _NODE_SEGMENT_BYTES:
        return
    try:
        descriptor, path = tempfile.mkstemp(prefix='hoid-', suffix='.xml')
    except OSError:
        return
    atexit.register(Path(path).unlink, missing_ok=True)
    with os.fdopen(descriptor, 'w', encoding='utf-8') as file:
        file.write(_SEGMENT_SIZE.sub(rf'\g<1>{_NODE_SEGMENT_BYTES}', text))
    os.environ[_FULL_PROFILE] = os.environ[PROFILE_VARIABLE]
    os.environ[PROFILE_VARIABLE] = path


def full_profile() -> str:
    """Return the path of the Fast DDS profile for a process that sends images, or ''."""
    return os.environ.get(_FULL_PROFILE) or os.environ.get(PROFILE_VARIABLE, '')


def shared_memory_problem() -> str:
    own_mb = max((path.stat().st_size / _BYTES_PER_MB for path in _own_segments()), default=0.0)
    if own_mb >= _segment_mb():
        return ''
    return (
        f'Fast DDS got no shared memory for images, so that most of them get lost: {_FOLDER} has '
        f'{_free_mb():.0f} MB free; {_REMEDY}'
    )


def restrict_segments() -> None:
    """Stop other users from reading this process's segments, as Fast DDS lets everybody do."""
    for segment in _own_segments():
        with contextlib.suppress(OSError):
            segment.chmod(0o600)


def clean_shared_memory() -> None:
    """Remove segments of killed processes, if the command `fastdds shm clean` is available."""
    tool = shutil.which(
        'fastdds', path=os.pathsep.join([str(Path(sys.executable).parent), os.defpath])
    )
    if tool is None:
        return
    with contextlib.suppress(subprocess.TimeoutExpired, OSError):
        subprocess.run([tool, 'shm', 'clean'], capture_output=True, check=False, timeout=20)


def _segment_mb() -> float:
    found = _SEGMENT_SIZE.search(_profile_text())
    return int(found[2]) / _BYTES_PER_MB if found else 0.0


def _profile_text() -> str:
    """Return the text of the Fast DDS profile; '' without a profile or with another middleware."""
    if not uses_fast_dds():
        return ''
    try:
        return Path(os.environ[PROFILE_VARIABLE]).read_text(encoding='utf-8')
    except (KeyError, OSError, UnicodeDecodeError):
        return ''


def _own_segments() -> Iterator[Path]:
    """Yield the files of this process's segments, found by the lock files that it holds open."""
    for descriptor in Path('/proc/self/fd').iterdir():
        with contextlib.suppress(OSError):  # the descriptor was closed in the meantime
            path = str(descriptor.readlink())
            segment = Path(path.removesuffix('_el'))
            if _LOCK_FILE.fullmatch(path) and segment.exists():
                yield segment


def _free_mb() -> float:
    try:
        found = os.statvfs(_FOLDER)
    except OSError:
        return 0.0
    return found.f_bavail * found.f_frsize / _BYTES_PER_MB
