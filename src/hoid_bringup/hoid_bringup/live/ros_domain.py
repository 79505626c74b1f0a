"""A free ROS domain, so that two replays on a computer do not receive each other's messages."""

from __future__ import annotations

import itertools
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from hoid_common.errors import ConfigError

VARIABLE = 'ROS_DOMAIN_ID'
_FIRST, _COUNT = 1, 100  # ROS 2's documentation recommends domains up to 101
_STRIDE = 37  # chosen: processes with consecutive ids then start far apart
# No domain twice: participants of the previous one may still be known for a while.
_USED = itertools.count()
_PORT_BASE = 32768  # a bound port marks a domain as taken, as ROS's domain_coordinator does


@contextmanager
def own_domain() -> Iterator[int]:
    """Reserve a ROS domain for the block and yield it; ROS_DOMAIN_ID is kept where it is set.

    Raises:
        ConfigError: ROS_DOMAIN_ID is not a number, or no domain is free.
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
    for attempt in itertools.islice(_USED, _COUNT):
        domain = _FIRST + (_STRIDE * os.getpid() + attempt) % _COUNT
        port = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
        try:
            port.bind(('', _PORT_BASE + domain))
        except OSError:
            continue
        return domain
    raise ConfigError(f'no ROS domain from {_FIRST} to {_COUNT} is free; set {VARIABLE}')
