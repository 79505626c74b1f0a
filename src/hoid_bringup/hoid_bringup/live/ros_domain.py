"""Choice of a free ROS domain, so that two replays on a computer do not disturb each other."""

from __future__ import annotations

import itertools
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from hoid_common.errors import ConfigError

VARIABLE = 'ROS_DOMAIN_ID'
_FIRST, _COUNT = 1, 100  # ROS 2's documentation recommends domains up to 101
_STRIDE = 37  # chosen: processes with successive ids then begin with domains that are far apart
# Number of domains that this process has tried. It reuses a domain only after all others, because
# participants of an earlier replay may still be known there for a while.
_USED = itertools.count()
_PORT_BASE = 32768  # a bound port marks a domain as taken, as in ROS's domain_coordinator


@contextmanager
def own_domain() -> Iterator[int]:
    """Reserve a free ROS domain for the block, set ROS_DOMAIN_ID to it, and yield it.

    If ROS_DOMAIN_ID is set, that is used. ConfigError if it is not a number, or no domain is free.
    """
    chosen = os.environ.get(VARIABLE, '')
    if chosen:
        if not chosen.isdecimal():
            raise ConfigError(f'{VARIABLE} is "{chosen}", not a number: set it from 0 to 232')
        yield int(chosen)
        return
    with ExitStack() as stack:
        domain = _reserve(stack)
        os.environ[VARIABLE] = str(domain)
        stack.callback(os.environ.pop, VARIABLE, None)
        yield domain


def _reserve(stack: ExitStack) -> int:
    """Return a free domain, which is reserved by a bound port until the stack is closed."""
    for attempt in itertools.islice(_USED, _COUNT):
        domain = _FIRST + (_STRIDE * os.getpid() + attempt) % _COUNT
        port = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
        try:
            port.bind(('', _PORT_BASE + domain))
        except OSError:
            continue
        return domain
    raise ConfigError(f'no ROS domain from {_FIRST} to {_COUNT} is free; set {VARIABLE}')
