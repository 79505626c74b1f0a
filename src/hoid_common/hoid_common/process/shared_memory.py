"""The shared memory that images go through: of /dev/shm, Fast DDS takes a segment per process."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from hoid_common.errors import InputError

_FOLDER = '/dev/shm'  # noqa: S108 - where Fast DDS keeps it
_SEGMENT_SIZE = re.compile(
    r'<type>SHM</type>(?:(?!</transport_descriptor>).)*?<segment_size>\s*(\d+)', re.DOTALL
)
_LOCK_FILE = re.compile(rf'{_FOLDER}/fastrtps_[0-9a-f]+_el')
_BOOKKEEPING = 1.06  # a segment's file, of its size
_BYTES_PER_MB = 2**20
_REMEDY = 'a container needs --shm-size=1g or --ipc=host'


def check_shared_memory(num_processes: int) -> None:
    """Check that there is room for as many processes, each of one ROS context.

    Raises:
        InputError: There is not, even without leftovers. Who gets no segment loses most images.
    """
    each_mb = _BOOKKEEPING * _segment_mb()
    if _free_mb() < num_processes * each_mb:
        clean_shared_memory()
    if _free_mb() < num_processes * each_mb:
        raise InputError(
            f'{_FOLDER} has {_free_mb():.0f} MB free, and {num_processes} processes take '
            f'{each_mb:.0f} MB each, or images get lost; {_REMEDY}'
        )


def missing_shared_memory() -> str:
    """Return what to say where this process's ROS context got no segment of the size asked for."""
    if _own_segment_mb() >= _segment_mb():
        return ''
    return (
        f'Fast DDS got no shared memory for images, so that most get lost: {_FOLDER} has '
        f'{_free_mb():.0f} MB free; {_REMEDY}'
    )


def clean_shared_memory() -> None:
    """Remove the segments that killed nodes left behind; those in use stay."""
    tool = shutil.which(
        'fastdds', path=os.pathsep.join([str(Path(sys.executable).parent), os.defpath])
    )
    if tool is None:
        return
    with contextlib.suppress(subprocess.TimeoutExpired, OSError):
        subprocess.run([tool, 'shm', 'clean'], capture_output=True, check=False, timeout=20)


def _segment_mb() -> float:
    """Return what the transport profile asks for; 0 for none and for another middleware."""
    if 'fastrtps' not in os.environ.get('RMW_IMPLEMENTATION', 'rmw_fastrtps_cpp'):
        return 0.0
    try:
        profile = Path(os.environ['FASTRTPS_DEFAULT_PROFILES_FILE']).read_text(encoding='utf-8')
    except (KeyError, OSError, UnicodeDecodeError):
        return 0.0
    found = _SEGMENT_SIZE.search(profile)
    return int(found[1]) / _BYTES_PER_MB if found else 0.0


def _own_segment_mb() -> float:
    """Return the size of this process's largest segment; each has a lock file, which it holds."""
    sizes_mb = [0.0]
    for descriptor in Path('/proc/self/fd').iterdir():
        with contextlib.suppress(OSError):  # closed meanwhile
            path = str(descriptor.readlink())
            if _LOCK_FILE.fullmatch(path):
                sizes_mb.append(Path(path.removesuffix('_el')).stat().st_size / _BYTES_PER_MB)
    return max(sizes_mb)


def _free_mb() -> float:
    try:
        found = os.statvfs(_FOLDER)
    except OSError:
        return 0.0
    return found.f_bavail * found.f_frsize / _BYTES_PER_MB
