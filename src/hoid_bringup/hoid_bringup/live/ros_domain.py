"""A ROS domain of one's own, so that two replays on a machine do not hear each other."""

from __future__ import annotations

import itertools
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from hoid_common.errors import ConfigError

VARIABLE = 'ROS_DOMAIN_ID'
_FIRST, _COUNT = 1, 100
_STRIDE = 37  # between processes that start together, so that they do not follow each other
_USED = itertools.count()  # not the same one twice: the dead are heard for a while
_PORT_BASE = 32768  # a bound port marks a domain as taken; ROS's domain_coordinator does the same


@contextmanager
def own_domain() -> Iterator[int]:
    """Reserve a domain for as long as the block lasts; one that the user has set is kept.

    Raises:
        ConfigError: The user's is not a number, or none is free.
    """
    chosen = os.environ.get(VARIABLE, '')
    if chosen:
        if not chosen.isdecimal():
            raise ConfigError(f'{VARIABLE} is "{chosen}", not a number from 0 to 232')
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
        mark = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
        try:
            mark.bind(('', _PORT_BASE + domain))
        except OSError:
            continue
        return domain
    raise ConfigError(f'no ROS domain from {_FIRST} to {_COUNT} is free; set {VARIABLE}')
