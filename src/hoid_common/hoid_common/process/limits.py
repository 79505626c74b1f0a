"""Checks of system limits when a process starts, since it would fail with unclear errors later."""

from __future__ import annotations

import resource

from hoid_common.errors import ConfigError

_MIN_DESCRIPTORS = 256
"""Least limit of open files. Chosen: several times the 34 files that a node opens."""
_BYTES_PER_MB = 2**20
# Chosen: more than the 2.1 GB of address space that a benchmark in a building needed.
_MIN_ADDRESS_SPACE_MB = 3000
_MIN_FILE_MB = 256  # chosen: several times the 64 MB of Fast DDS's shared memory for images


def require_memory() -> None:
    _require(
        resource.RLIMIT_AS,
        _MIN_ADDRESS_SPACE_MB,
        'have {} MB of address space',
        '"ulimit -v unlimited" in the shell, LimitAS=infinity in a service of systemd',
    )


def require_node_limits() -> None:
    """Raise ConfigError if the limit of memory, file size or open files is too low for a node."""
    require_memory()
    _require(
        resource.RLIMIT_FSIZE,
        _MIN_FILE_MB,
        'write files of {} MB, also for images in shared memory,',
        '"ulimit -f unlimited" in the shell, LimitFSIZE=infinity in a service of systemd',
    )
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft >= _MIN_DESCRIPTORS or soft == resource.RLIM_INFINITY:
        return
    if hard != resource.RLIM_INFINITY and hard < _MIN_DESCRIPTORS:
        raise ConfigError(
            f'this process may have {hard} files open at once and needs {_MIN_DESCRIPTORS}: raise '
            'the limit ("ulimit -n 1024" in the shell, LimitNOFILE=1024 in a service of systemd, '
            '"--ulimit nofile=1024" for docker)'
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (_MIN_DESCRIPTORS, hard))


def _require(kind: int, least_mb: int, what: str, remedy: str) -> None:
    soft, hard = resource.getrlimit(kind)
    least = least_mb * _BYTES_PER_MB
    if soft == resource.RLIM_INFINITY or soft >= least:
        return
    if hard == resource.RLIM_INFINITY or hard >= least:
        resource.setrlimit(kind, (hard, hard))
        return
    raise ConfigError(
        f'this process may {what.format(hard // _BYTES_PER_MB)} and needs {least_mb}: raise the '
        f'limit ({remedy})'
    )
