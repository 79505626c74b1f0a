"""Two simulated hosts: network namespaces connected by a link that can lose packets."""

from __future__ import annotations

import os
import shutil
import subprocess
from typing import Self

from hoid_common.errors import HoidError

CAMERA_HOST, ROBOT_HOST = 'a', 'b'
_ADDRESSES = {CAMERA_HOST: '10.231.7.1/24', ROBOT_HOST: '10.231.7.2/24'}
_TABLES = ('iptables-legacy', 'iptables')
# Separate /dev/shm: Fast DDS uses shared memory between processes that see the same one.
_OWN_MEMORY = 'mount -t tmpfs tmpfs /dev/shm && exec "$@"'


class NoHostsError(HoidError):
    """The system allows no network namespaces, or has no means to drop packets."""


class TwoHosts:
    """Context manager that creates the namespaces and the link, and removes them.

    Raises:
        NoHostsError: The namespaces or the link cannot be created.
    """

    def __init__(self) -> None:
        self._name = f'hoid{os.getpid()}'
        self._tables = next((t for t in _TABLES if shutil.which(t) is not None), None)

    def __enter__(self) -> Self:
        try:
            self._make()
            self.lose(0.0)
        except BaseException:
            self._remove()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._remove()

    def on(self, host: str) -> tuple[str, ...]:
        """Return the prefix that runs a command on a host."""
        return (*self._on(host), 'sh', '-c', _OWN_MEMORY, 'sh')

    def lose(self, share: float) -> None:
        """Drop this share of the packets at random, in both directions; 1 cuts the link."""
        for host in _ADDRESSES:
            if not self._lose_by_queue(host, share):
                self._lose_by_table(host, share)

    def _make(self) -> None:
        for host in _ADDRESSES:
            _do('ip', 'netns', 'add', self._space(host))
        ends = [self._space(host) for host in _ADDRESSES]
        _do('ip', 'link', 'add', ends[0], 'type', 'veth', 'peer', 'name', ends[1])
        for host, address in _ADDRESSES.items():
            end = self._space(host)
            _do('ip', 'link', 'set', end, 'netns', end)
            inside = (*self._on(host), 'ip')
            _do(*inside, 'address', 'add', address, 'dev', end)
            for link in ('lo', end):
                _do(*inside, 'link', 'set', link, 'up')
            _do(*inside, 'route', 'add', 'default', 'dev', end)  # a route for multicast discovery

    def _remove(self) -> None:
        for host in _ADDRESSES:
            if shutil.which('ip') is not None:
                subprocess.run(
                    ('ip', 'netns', 'delete', self._space(host)), capture_output=True, check=False
                )

    def _space(self, host: str) -> str:
        return f'{self._name}{host}'

    def _on(self, host: str) -> tuple[str, ...]:
        return ('ip', 'netns', 'exec', self._space(host))

    def _lose_by_queue(self, host: str, share: float) -> bool:
        """Drop packets by the netem queue; return False if the kernel lacks it."""
        loss = ('netem', 'loss', f'{100 * share:g}%')
        command = ('tc', 'qdisc', 'replace', 'dev', self._space(host), 'root', *loss)
        done = subprocess.run((*self._on(host), *command), capture_output=True, check=False)
        return done.returncode == 0

    def _lose_by_table(self, host: str, share: float) -> None:
        if self._tables is None:
            raise NoHostsError('neither netem nor iptables is available to drop packets')
        chain = (*self._on(host), self._tables, '-t', 'raw')
        _do(*chain, '-F', 'PREROUTING')
        if share > 0:
            chance = ('statistic', '--mode', 'random', '--probability', f'{share:g}')
            incoming = ('-i', self._space(host), '-m', *chance)
            _do(*chain, '-A', 'PREROUTING', *incoming, '-j', 'DROP')


def _do(*command: str) -> None:
    try:
        subprocess.run(command, capture_output=True, check=True, text=True)
    except FileNotFoundError as error:
        raise NoHostsError(f'{command[0]} is not installed') from error
    except subprocess.CalledProcessError as error:
        raise NoHostsError(f'{" ".join(command)}: {" ".join(error.stderr.split())}') from error
