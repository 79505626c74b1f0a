"""A disk that is full or read-only while files are written (slow disks: `slow_disk.py`)."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from threading import Event, Thread

from diagnostic_msgs.msg import DiagnosticArray
from hoid_msgs.srv import SaveMap, SaveTrajectory
from std_srvs.srv import Trigger

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.node_harness import CaseResult, NodeHarness
from hoid_benchmarks.faults.live.services import ANSWER_S
from hoid_bringup.live.node_specs import SCENE, SLAM
from hoid_common import topics
from hoid_common.io.files import abandoned_scratch_folders
from hoid_common.ros import qos

FULL, READ_ONLY, SLOW = 'disk full', 'disk read-only', 'disk slow'
_DISK_MB = 64
_CHECKPOINT_S = 60.0  # the pause after a checkpoint is twenty times its duration
_REFILL_S, _PAUSE_S = 0.001, 0.3
_FAILED = 'checkpoints that failed'
_SERVICES = (
    (SLAM, SaveMap, topics.SAVE_MAP, 'kept.hoidmap'),
    (SLAM, SaveTrajectory, topics.SAVE_TRAJECTORY, 'kept.txt'),
    (SCENE, SaveMap, topics.SAVE_CLOUD, 'kept.ply'),
)

DiskFault = Callable[[Path], AbstractContextManager[None]]


def disk_cases(
    harness: NodeHarness, bags_of: Callable[[Path], tuple[tuple[str, ...], ...]], seeds: range
) -> Iterator[Outcome]:
    """Yield the outcomes of a full disk and of a read-only disk for each seed.

    Args:
        harness: The running nodes; the disk is mounted at their map folder.
        bags_of: Returns the commands that write a bag to a path.
        seeds: Seeds of the cases; each seed gives one case of each kind.
    """
    if refused := run_command(
        'mount', '-t', 'tmpfs', '-o', f'size={_DISK_MB}m', 'tmpfs', harness.maps
    ):
        yield from (Outcome(kind, seeds.start, '', skipped=refused) for kind in (FULL, READ_ONLY))
        return
    try:
        saves = SaveChecks(harness)
        if complaint := saves.first_complaint():
            yield Outcome(FULL, seeds.start, f'on a good disk: {complaint}')
            return
        for seed in seeds:
            for kind, disk_fault in ((FULL, _filled), (READ_ONLY, _read_only)):

                def trouble(disk_fault: DiskFault = disk_fault) -> CaseResult:
                    with disk_fault(harness.maps):
                        complaint = saves.complaint(are_done=False)
                        for command in bags_of(harness.maps / 'bag'):
                            complaint = complaint or _bag_complaint(harness, command)
                    return CaseResult(complaint or saves.first_complaint())

                yield harness.outcome(kind, seed, trouble)
    finally:
        run_command('umount', '--lazy', harness.maps)


@contextmanager
def _filled(folder: Path) -> Iterator[None]:
    """Fill a disk, and fill it again whenever a file is removed."""
    filler, is_ended = folder / 'filler', Event()

    def fill() -> None:
        with filler.open('wb', buffering=0) as file:
            while not is_ended.wait(_REFILL_S):
                with suppress(OSError):
                    while True:
                        file.write(bytes(1 << 16))

    thread = Thread(target=fill)
    thread.start()
    time.sleep(_PAUSE_S)
    try:
        yield
    finally:
        is_ended.set()
        thread.join()
        filler.unlink()


@contextmanager
def _read_only(folder: Path) -> Iterator[None]:
    end_s = time.monotonic() + ANSWER_S
    while run_command('mount', '-o', 'remount,ro', folder) and time.monotonic() < end_s:
        time.sleep(_PAUSE_S)  # the remount is refused while a file is being written
    try:
        yield
    finally:
        run_command('mount', '-o', 'remount,rw', folder)


class SaveChecks:
    """Requests all files of both nodes, and checks answers, files and diagnostics."""

    def __init__(self, harness: NodeHarness) -> None:
        self._sender, self._maps = harness.sender, harness.maps
        self._services = harness.services
        self._clients = {
            name: (type_, self._services.client(type_, node, service))
            for node, type_, service, name in _SERVICES
        }
        self._reset = self._services.client(Trigger, SLAM, topics.RESET)
        self._failed = 0  # failed checkpoints, as counted by the diagnostics
        harness.sender.node.create_subscription(
            DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, qos.OUTPUT
        )

    def first_complaint(self) -> str:
        """Return `complaint(are_done=True)` once there is a map of which files can be written.

        After a reset, the scene begins some images later than the SLAM node.
        """
        end_s = time.monotonic() + _CHECKPOINT_S
        while (complaint := self.complaint(are_done=True)) and time.monotonic() < end_s:
            self._sender.send()
        return complaint

    def complaint(self, *, are_done: bool) -> str:
        """Request all files; return what is wrong with the answers and the files, '' if nothing.

        Args:
            are_done: Whether writing must succeed; otherwise it must fail and be reported.
        """
        failed = self._failed
        for name, (type_, client) in self._clients.items():
            before = _identity(self._maps / name)
            answer = self._services.answer(client, type_.Request(name=name))
            if answer is None:
                return f'{client.srv_name} gives no answer'
            is_new = _identity(self._maps / name) != before
            # On a full disk, a save may succeed in the space of the file that it replaced.
            is_right = answer.success == is_new and (is_new or not are_done)
            if not is_right or not answer.message or '\n' in answer.message:
                return f'{client.srv_name} answers {answer.success}: {answer.message}'
        if left := abandoned_scratch_folders(self._maps):
            return f'{left[0].name} was left'
        if are_done:
            return ''
        # Only a changed map is written; after a reset, the next checkpoint comes soon.
        if self._services.answer(self._reset, Trigger.Request()) is None:
            return 'no answer to reset'
        end_s = time.monotonic() + _CHECKPOINT_S
        while self._failed == failed and time.monotonic() < end_s:
            self._sender.send()
        return '' if self._failed > failed else 'the diagnostics count no failed checkpoint'

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for value in (v for status in msg.status for v in status.values if v.key == _FAILED):
            self._failed = int(value.value)


def _identity(path: Path) -> tuple[int, int] | None:
    """Return inode and time of a file, which differ after a replacement; None: no file."""
    found = path.stat() if path.exists() else None
    return (found.st_ino, found.st_mtime_ns) if found else None


def _bag_complaint(harness: NodeHarness, command: tuple[str, ...]) -> str:
    """Return what is wrong with the end of a command that cannot write its bag; '' if nothing."""
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    while child.poll() is None:
        harness.sender.send()
    stderr = child.communicate()[1]
    lines = [line for line in stderr.splitlines() if line.startswith('hoid ')]
    if child.returncode != 1 or len(lines) != 1 or 'Traceback' in stderr:
        return f'{" ".join(command[2:])} ends with {child.returncode}: {stderr[-300:]}'
    left = [*abandoned_scratch_folders(harness.maps), *harness.maps.glob('bag*')]
    return f'{left[0].name} was left' if left else ''


def run_command(*command: str | Path) -> str:
    """Run a command and return why it fails; '' if it succeeds."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return f'there is no {command[0]}'
    return ' '.join(done.stderr.split()) if done.returncode else ''
