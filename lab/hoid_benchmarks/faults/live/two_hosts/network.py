"""A camera on one host and the nodes on another, joined by a link that loses packets."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.two_hosts.ends import COMPLAINT, ODOMETRY, SENT, camera, robot
from hoid_benchmarks.faults.live.two_hosts.hosts import (
    CAMERA_HOST,
    ROBOT_HOST,
    NoHostsError,
    TwoHosts,
)
from hoid_bringup.live.ros_domain import own_domain
from hoid_bringup.live.supervisor import ProcessSpec, Supervisor
from hoid_common.values import NS_PER_S

_KIND = 'two hosts'
_PROFILE = (
    Path(__file__).resolve().parents[5] / 'src/hoid_common/config/fastdds_network_profile.xml'
)
_START_S, _PHASE_S, _LATE_S = 60.0, 10.0, 1.0
_BACK_S = 3.0  # after which all must be as with a clean link
_SOME = 20  # odometry, and the nodes are up


class Weather(NamedTuple):
    """What the link loses for a while."""

    name: str
    lost: float  # share of packets
    duration_s: float
    least: float  # share of the clean rate that odometry must have meanwhile
    is_said: bool  # by diagnostics


WEATHERS = (
    Weather('1 % of packets lost', 0.01, _PHASE_S, 0.95, is_said=False),
    Weather('5 % of packets lost', 0.05, _PHASE_S, 0.8, is_said=False),
    Weather('30 % of packets lost', 0.3, _PHASE_S, 0.0, is_said=False),
    Weather('no link for 5 s', 1.0, 5.0, 0.0, is_said=True),
)


def network_cases(folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield one outcome for each weather and seed."""
    folder.mkdir(parents=True)
    try:
        with own_domain(), TwoHosts() as hosts:
            yield from _cases(hosts, folder, seeds)
    except NoHostsError as error:
        yield Outcome(_KIND, seeds.start, '', skipped=str(error))


def _cases(hosts: TwoHosts, folder: Path, seeds: range) -> Iterator[Outcome]:
    environment = {
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',
        'FASTRTPS_DEFAULT_PROFILES_FILE': str(_PROFILE),
    }
    module = (sys.executable, '-m', 'hoid_benchmarks.faults.live.two_hosts.ends')
    specs = [
        ProcessSpec(role, (*hosts.on(host), *module, role, str(folder)), environment)
        for role, host in ((camera.__name__, CAMERA_HOST), (robot.__name__, ROBOT_HOST))
    ]
    with Supervisor(specs, log_dir=folder):
        events = _Events(folder)
        if not events.is_up():
            yield Outcome(_KIND, seeds.start, 'no odometry over a clean link')
            return
        clean = events.share_while(_PHASE_S)
        for seed in seeds:
            for weather in WEATHERS:
                yield _weather_case(hosts, events, weather, seed, clean)


def _weather_case(
    hosts: TwoHosts, events: _Events, weather: Weather, seed: int, clean: float
) -> Outcome:
    begin_ns = time.time_ns()
    hosts.lose(weather.lost)
    share = events.share_while(weather.duration_s) / clean
    hosts.lose(0.0)
    end_ns = time.time_ns()
    time.sleep(_BACK_S)
    after = events.share_while(_PHASE_S / 2) / clean
    back_s = (events.first_after(end_ns) - end_ns) / NS_PER_S
    complaint = ''
    if share < weather.least:
        complaint = f'odometry at {share:.2f} of the clean rate'
    elif after < WEATHERS[0].least:
        complaint = f'odometry at {after:.2f} of the clean rate {_BACK_S:g} s later'
    elif weather.is_said and 'get lost' not in events.said_since(begin_ns):
        complaint = 'diagnostics name no loss'
    note = f'odometry {share:.2f}, back in {back_s:.1f} s'
    return Outcome(f'{_KIND}: {weather.name}', seed, complaint, wall_s=back_s, note=note)


class _Events:
    """What the two hosts have written so far."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def is_up(self) -> bool:
        """Wait for odometry; return whether it came."""
        end_s = time.monotonic() + _START_S
        while time.monotonic() < end_s:
            if len(self._stamps(ODOMETRY)) > _SOME:
                return True
            time.sleep(0.5)
        return False

    def share_while(self, duration_s: float) -> float:
        """Wait, and return the share of images sent meanwhile that odometry came of."""
        begin_ns = time.time_ns()
        time.sleep(duration_s)
        end_ns = time.time_ns()
        time.sleep(_LATE_S)
        sent = [s for s in self._stamps(SENT) if begin_ns <= s < end_ns]
        return len(set(sent) & set(self._stamps(ODOMETRY))) / max(len(sent), 1)

    def first_after(self, stamp_ns: int) -> int:
        """Return when the first odometry came of an image that was taken after a time."""
        lines = [line.split() for line in self._lines() if line.startswith(ODOMETRY)]
        heard = [int(heard_ns) for _, stamp, heard_ns in lines if int(stamp) >= stamp_ns]
        return min(heard, default=time.time_ns())

    def said_since(self, stamp_ns: int) -> str:
        """Return what diagnostics complained of."""
        lines = [line.split(maxsplit=2) for line in self._lines() if line.startswith(COMPLAINT)]
        return '\n'.join(text for _, when_ns, text in lines if int(when_ns) >= stamp_ns)

    def _stamps(self, what: str) -> list[int]:
        return sorted(int(line.split()[1]) for line in self._lines() if line.startswith(what))

    def _lines(self) -> list[str]:
        files = [self._folder / role.__name__ for role in (camera, robot)]
        texts = [f.read_text(encoding='utf-8') for f in files if f.exists()]
        # The last line may not be whole yet.
        return [line for text in texts for line in text.rpartition('\n')[0].splitlines()]
