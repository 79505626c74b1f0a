"""System limits that must be high enough for a process, checked at its start."""

from __future__ import annotations

import resource

from hoid_common.errors import ConfigError

_MIN_DESCRIPTORS = 256
"""Open files that a process may need: several times the 34 that were measured for a node."""


def require_descriptors() -> None:
    """Raise this process's soft limit of open files to 256 if it is lower.

    Raises:
        ConfigError: The hard limit is lower: the process would fail later, at any point.
    """
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
