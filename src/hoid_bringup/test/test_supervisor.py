from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hoid_bringup.live.supervisor import ProcessExit, ProcessSpec, Supervisor, last_line
from hoid_common.errors import InputError
from hoid_common.process.entry import EXIT_CONFIG

STUBBORN = (
    'import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN);'
    'signal.signal(signal.SIGTERM, signal.SIG_IGN); print("ready", flush=True); time.sleep(60)'
)


def python(name: str, code: str) -> ProcessSpec:
    return ProcessSpec(name, (sys.executable, '-c', code))


def wait_for(path: Path, text: str) -> None:
    deadline_s = time.monotonic() + 60
    while not (path.exists() and text in path.read_text()):
        assert time.monotonic() < deadline_s, f'{path} never had {text}'
        time.sleep(0.01)


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_child_that_ignores_signals_is_killed(tmp_path: Path) -> None:
    supervisor = Supervisor([python('stubborn', STUBBORN)], log_dir=tmp_path)
    with supervisor:
        wait_for(tmp_path / 'stubborn.log', 'ready')
        pid = supervisor.pids['stubborn']
        start_s = time.monotonic()
        supervisor.stop(grace_s=0.2)
    assert not is_alive(pid)
    assert time.monotonic() - start_s < 4.0


def test_the_end_of_a_child_is_reported_with_its_status() -> None:
    with Supervisor([python('short', 'raise SystemExit(3)'), python('long', 'input()')]) as group:
        exits: list[ProcessExit] = []
        while len(exits) < 2:
            exits += group.poll()
            time.sleep(0.01)
    assert {e.name: e.status for e in exits} == {'short': 3, 'long': 1}  # stdin is closed
    assert str(ProcessExit('slam', -signal.SIGKILL)) == 'slam ended (signal SIGKILL)'


def test_a_dead_child_is_restarted(tmp_path: Path) -> None:
    spec = python('phoenix', 'import os; print(os.getpid(), flush=True); os._exit(1)')
    with Supervisor([spec], restart=True, restart_period_s=0.0, log_dir=tmp_path) as group:
        deadline_s = time.monotonic() + 60
        while len((tmp_path / 'phoenix.log').read_text().split()) < 2:
            group.poll()
            assert time.monotonic() < deadline_s
            time.sleep(0.01)


def test_a_child_is_restarted_at_once_unless_it_was_just_started() -> None:
    with Supervisor([python('once', 'input()')], restart=True, restart_period_s=60.0) as group:
        while not group.poll():
            time.sleep(0.01)
        assert group.poll() == []
        assert group.pids == {}  # it is not due yet
    with Supervisor([python('lasting', STUBBORN)], restart=True, restart_period_s=0.1) as group:
        pid = group.pids['lasting']
        time.sleep(0.1)
        os.kill(pid, signal.SIGKILL)
        while not group.poll():
            time.sleep(0.01)
        assert group.pids['lasting'] != pid


def exits_of(group: Supervisor, number: int) -> list[ProcessExit]:
    """Poll until `number` children have ended, and return their exits in order."""
    exits: list[ProcessExit] = []
    deadline_s = time.monotonic() + 60
    while len(exits) < number:
        exits += group.poll()
        assert time.monotonic() < deadline_s, exits
        time.sleep(0.01)
    return exits


def test_a_child_that_refuses_its_first_start_is_not_restarted(tmp_path: Path) -> None:
    spec = python('proud', f'print("no", flush=True); raise SystemExit({EXIT_CONFIG})')
    with Supervisor([spec], restart=True, restart_period_s=0.0, log_dir=tmp_path) as group:
        (ended,) = exits_of(group, 1)
        assert (str(ended), ended.restart_s) == ('proud refused to start', None)
        assert group.poll() == []
        assert group.pids == {}
    assert (tmp_path / 'proud.log').read_text() == 'no\n'


def test_a_child_that_refuses_a_restart_is_tried_again_until_it_starts(tmp_path: Path) -> None:
    """A file that the child needs is missing for a time, as if it were damaged and repaired."""
    good, period_s = tmp_path / 'good', 0.05
    code = (
        'import time; from pathlib import Path\n'
        f'if not Path({str(good)!r}).exists(): raise SystemExit({EXIT_CONFIG})\n'
        'print("ready", flush=True); time.sleep(60)'
    )
    good.touch()
    specs = [python('node', code), python('other', STUBBORN)]
    with Supervisor(specs, restart=True, restart_period_s=period_s, log_dir=tmp_path) as group:
        wait_for(tmp_path / 'node.log', 'ready')
        other = group.pids['other']
        good.unlink()
        os.kill(group.pids['node'], signal.SIGKILL)
        killed, *refused = exits_of(group, 5)
        assert killed.status == -signal.SIGKILL
        assert killed.restart_s == pytest.approx(0.0, abs=period_s)  # since it was started
        assert all(ended.refused_to_start for ended in refused)
        waits_s = [ended.restart_s for ended in refused]
        assert waits_s == pytest.approx([period_s * 2**i for i in range(4)])
        good.touch()
        deadline_s = time.monotonic() + 60
        while (tmp_path / 'node.log').read_text().count('ready') < 2:
            assert group.poll() == []
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        assert group.pids['other'] == other
        group.stop(grace_s=0.2)


def test_a_restart_that_the_system_refuses_is_tried_again(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    logs = tmp_path / 'logs'
    spec = python('node', 'import time; print("ready", flush=True); time.sleep(60)')
    with Supervisor([spec], restart=True, restart_period_s=0.05, log_dir=logs) as group:
        wait_for(logs / 'node.log', 'ready')
        logs.rename(tmp_path / 'moved')
        logs.write_text('a file in place of the folder')
        os.kill(group.pids['node'], signal.SIGKILL)
        exits_of(group, 1)
        deadline_s = time.monotonic() + 60
        while caplog.text.count('node cannot be started') < 3:
            group.poll()
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        assert 'logs: cannot be written: ' in caplog.text
        logs.unlink()
        while not group.pids:
            group.poll()
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        wait_for(logs / 'node.log', 'ready')


NOTING = (
    'import signal, sys, time\n'
    'def note(number, _): print(signal.Signals(number).name, flush=True); sys.exit()\n'
    'for sign in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1): signal.signal(sign, note)\n'
    'print("ready", flush=True); time.sleep(60)'
)


@pytest.mark.parametrize(
    ('error', 'expected'),
    [(None, 'SIGINT'), (KeyboardInterrupt, 'SIGINT'), (InputError, 'SIGUSR1')],
)
def test_children_learn_whether_the_end_was_asked_for(
    error: type[BaseException] | None, expected: str, tmp_path: Path
) -> None:
    argv = (sys.executable, '-c', NOTING)
    spec = ProcessSpec('child', argv, failure_signal=signal.SIGUSR1)
    try:
        with Supervisor([spec], log_dir=tmp_path):
            wait_for(tmp_path / 'child.log', 'ready\n')
            if error is not None:
                raise error
    except (KeyboardInterrupt, InputError):
        pass
    assert (tmp_path / 'child.log').read_text().split() == ['ready', expected]


@pytest.mark.slow
def test_children_end_when_their_supervisor_is_killed(tmp_path: Path) -> None:
    code = (
        'import sys, time; from pathlib import Path; from hoid_bringup.live.supervisor import *;'
        'spec = ProcessSpec("child", (sys.executable, "-c", "import time; time.sleep(60)"));'
        'group = Supervisor([spec]).__enter__();'
        f'Path({str(tmp_path / "pid")!r}).write_text(str(group.pids["child"]) + " ");'
        'time.sleep(60)'
    )
    env = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)}
    parent = subprocess.Popen([sys.executable, '-c', code], env=env)
    wait_for(tmp_path / 'pid', ' ')
    pid = int((tmp_path / 'pid').read_text())
    assert is_alive(pid)
    time.sleep(0.2)  # until setpriv has set the signal
    parent.kill()
    parent.wait()
    deadline_s = time.monotonic() + 5
    while is_alive(pid):
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def test_a_log_folder_that_cannot_be_created_is_an_error(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    supervisor = Supervisor([python('any', '')], log_dir=tmp_path / 'file' / 'logs')
    with pytest.raises(InputError, match='file/logs: cannot be written'), supervisor:
        pytest.fail('it started')


def test_processor_time_is_measured_by_child(tmp_path: Path) -> None:
    busy, idle = python('busy', 'while True: pass'), python('idle', 'import time; time.sleep(60)')
    with Supervisor([busy, idle], log_dir=tmp_path) as group:
        end_s = time.monotonic() + 20
        while group.cpu_s().get('busy', 0.0) < 0.5 and time.monotonic() < end_s:
            time.sleep(0.05)
        times = group.cpu_s()
    assert 0.5 <= times['busy'] < 20
    assert times['idle'] < times['busy']


def test_the_last_line_of_a_log_or_why_there_is_none(tmp_path: Path) -> None:
    log = tmp_path / 'node.log'
    assert last_line(log) == f'its log file {log} cannot be read: No such file or directory'
    log.write_text(' \n')
    assert last_line(log) == f'its log file {log} is empty'
    log.write_text('starts\nerror: the model is missing\n\n')
    assert last_line(log) == 'the model is missing'
