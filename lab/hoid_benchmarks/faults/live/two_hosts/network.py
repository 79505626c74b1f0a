"""A camera and the nodes on two hosts whose link loses packets."""

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
_BACK_S = 3.0  # time after which the rate of a clean link must be back
_SOME = 20  # odometry messages after which the nodes count as started


class LinkFault(NamedTuple):
    """Packet loss of the link for some time, and the required behavior."""

    name: str
    lost: float  # share of packets
    duration_s: float
    least: float  # required rate of odometry meanwhile, as a share of the rate over a clean link
    is_diagnosed: bool  # whether diagnostics must report the loss


LINK_FAULTS = (
    LinkFault('1 % of packets lost', 0.01, _PHASE_S, 0.95, is_diagnosed=False),
    LinkFault('5 % of packets lost', 0.05, _PHASE_S, 0.8, is_diagnosed=False),
    LinkFault('30 % of packets lost', 0.3, _PHASE_S, 0.0, is_diagnosed=False),
    LinkFault('no link for 5 s', 1.0, 5.0, 0.0, is_diagnosed=True),
)


def network_cases(folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield one outcome for each fault of the link and each seed."""
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
            for link_fault in LINK_FAULTS:
                yield _link_fault_case(hosts, events, link_fault, seed, clean)


def _link_fault_case(
    hosts: TwoHosts, events: _Events, link_fault: LinkFault, seed: int, clean: float
) -> Outcome:
    begin_ns = time.time_ns()
    hosts.lose(link_fault.lost)
    share = events.share_while(link_fault.duration_s) / clean
    hosts.lose(0.0)
    end_ns = time.time_ns()
    time.sleep(_BACK_S)
    after = events.share_while(_PHASE_S / 2) / clean
    back_s = (events.first_after(end_ns) - end_ns) / NS_PER_S
    complaint = ''
    if share < link_fault.least:
        complaint = f'odometry at {share:.2f} of the clean rate'
    elif after < LINK_FAULTS[0].least:
        complaint = f'odometry at {after:.2f} of the clean rate {_BACK_S:g} s later'
    elif link_fault.is_diagnosed and 'get lost' not in events.complaints_since(begin_ns):
        complaint = 'the diagnostics report no loss'
    note = f'odometry {share:.2f}, back in {back_s:.1f} s'
    return Outcome(f'{_KIND}: {link_fault.name}', seed, complaint, wall_s=back_s, note=note)


class _Events:
    """The events that the two hosts have written so far."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def is_up(self) -> bool:
        """Wait for odometry; return whether it arrived."""
        end_s = time.monotonic() + _START_S
        while time.monotonic() < end_s:
            if len(self._stamps(ODOMETRY)) > _SOME:
                return True
            time.sleep(0.5)
        return False

    def share_while(self, duration_s: float) -> float:
        """Wait for a time; return the share of the images sent meanwhile that have odometry."""
        begin_ns = time.time_ns()
        time.sleep(duration_s)
        end_ns = time.time_ns()
        time.sleep(_LATE_S)
        sent = [s for s in self._stamps(SENT) if begin_ns <= s < end_ns]
        return len(set(sent) & set(self._stamps(ODOMETRY))) / max(len(sent), 1)

    def first_after(self, stamp_ns: int) -> int:
        """Return the arrival time (ns) of the first odometry for an image taken after a stamp."""
        lines = [line.split() for line in self._lines() if line.startswith(ODOMETRY)]
        heard = [int(heard_ns) for _, stamp, heard_ns in lines if int(stamp) >= stamp_ns]
        return min(heard, default=time.time_ns())

    def complaints_since(self, stamp_ns: int) -> str:
        """Return the problems reported by diagnostics since a time, one per line."""
        lines = [line.split(maxsplit=2) for line in self._lines() if line.startswith(COMPLAINT)]
        return '\n'.join(text for _, when_ns, text in lines if int(when_ns) >= stamp_ns)

    def _stamps(self, what: str) -> list[int]:
        return sorted(int(line.split()[1]) for line in self._lines() if line.startswith(what))

    def _lines(self) -> list[str]:
        files = [self._folder / role.__name__ for role in (camera, robot)]
        texts = [f.read_text(encoding='utf-8') for f in files if f.exists()]
        # The last line may be incomplete.
        return [line for text in texts for line in text.rpartition('\n')[0].splitlines()]
