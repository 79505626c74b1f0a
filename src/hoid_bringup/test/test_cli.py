from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hoid_bringup import cli
from hoid_common.io.tum_text import write_tum
from hoid_common.values import Trajectory

ROOT = Path(__file__).parents[3]


def write_line(path: Path, n: int = 60) -> Path:
    T = np.tile(np.eye(4), (n, 1, 1))
    s = 0.1 * np.arange(n)
    T[:, :3, 3] = np.stack([s, np.sin(s), np.cos(s)], axis=1)
    write_tum(path, Trajectory(10**18 + 33_333_333 * np.arange(n), T))
    return path


def test_evaluate_prints_and_writes_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_line(tmp_path / 'a b.txt')
    out = tmp_path / 'numbers.json'
    assert cli.main(['evaluate', str(path), str(path), '--json', str(out)]) == 0
    assert 'RMSE 0.0000 m' in capsys.readouterr().out
    assert '"num_pairs": 60' in out.read_text()


@pytest.mark.parametrize('argv', [[], ['fly'], ['run'], ['evaluate', 'one']])
def test_wrong_usage_exits_with_status_2(argv: list[str]) -> None:
    with pytest.raises(SystemExit) as exit_info:
        cli.main(argv)
    assert exit_info.value.code == 2


@pytest.mark.slow
def test_verbose_commands_show_the_log_of_the_suite_without_that_of_libraries(
    tmp_path: Path,
) -> None:
    path = write_line(tmp_path / 'line.txt')
    code = (
        'import logging, sys; from hoid_bringup import cli; cli._check_names = lambda args: '
        '[logging.getLogger(n).log(*a) for n in ("rgbd_slam.loops", "matplotlib.font_manager") '
        'for a in ((10, "details of %s", n), (30, "a warning of %s", n))]; '
        'cli.main(sys.argv[1:])'
    )
    command = [sys.executable, '-c', code, 'evaluate', '-v', str(path), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert 'DEBUG rgbd_slam.loops: details of rgbd_slam.loops' in done.stderr
    assert 'a warning of matplotlib' in done.stderr
    assert 'details of matplotlib' not in done.stderr


@pytest.mark.parametrize('command', ['run', 'replay', 'view', 'pictures'])
def test_an_unknown_strategy_is_wrong_usage_in_every_command(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as exit_info:
        cli.main([command, 'SEQUENCE', '--out', 'DIR', '--filter', 'bogus'])
    assert exit_info.value.code == 2
    assert "--filter: invalid choice: 'bogus'" in capsys.readouterr().err


def test_an_interrupt_exits_with_status_130(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupted(_path: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr('hoid_bringup.commands.read_tum', interrupted)
    assert cli.main(['evaluate', str(tmp_path), str(tmp_path)]) == 130


BUSY = """
import sys, time
from hoid_bringup import cli, commands
def busy(path):
    print('busy', flush=True)
    time.sleep(60)
commands.read_tum = busy
sys.exit(cli.main(['evaluate', 'a', 'b']))
"""


@pytest.mark.slow
@pytest.mark.parametrize('name', ['SIGTERM', 'SIGHUP', 'SIGQUIT', 'SIGINT'])
def test_termination_signals_end_a_command_as_ctrl_c_does(name: str) -> None:
    argv = [sys.executable, '-c', BUSY]
    pipe = subprocess.PIPE
    with subprocess.Popen(argv, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == 'busy\n'
        process.send_signal(signal.Signals[name])
        _, stderr = process.communicate(timeout=10)
    assert process.returncode == 130
    assert stderr == 'hoid evaluate: interrupted\n'


@pytest.mark.slow
def test_a_command_that_ignores_sighup_still_does() -> None:
    code = 'import signal\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)' + BUSY
    argv = [sys.executable, '-c', code]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == 'busy\n'
        process.send_signal(signal.SIGHUP)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(timeout=0.5)
        process.kill()


def test_folders_of_killed_commands_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_line(tmp_path / 'path.txt')
    (tmp_path / '.bag.partial-12345678' / 'bag').mkdir(parents=True)
    (tmp_path / '.bag.partial-12345678' / 'bag' / 'bag.mcap').write_bytes(b'')
    (tmp_path / '.check.partial-abcdefgh').mkdir()
    assert cli.main(['evaluate', str(path), str(path)]) == 0
    first, second = capsys.readouterr().err.splitlines()
    assert '.bag.partial-12345678: left by a killed recording; "hoid info --repair"' in first
    assert '.check.partial-abcdefgh: left by a killed command' in second


@pytest.mark.slow
def test_an_interrupt_while_importing_gives_no_traceback() -> None:
    argv = [str(ROOT / 'hoid'), 'info', 'nothing']
    for i in range(12):
        with subprocess.Popen(argv, stderr=subprocess.PIPE, text=True, process_group=0) as process:
            time.sleep(0.06 * i)
            os.killpg(process.pid, signal.SIGINT)
            _, stderr = process.communicate(timeout=30)
        assert stderr in ('', 'hoid info: interrupted\n', 'hoid info: nothing: no such bag\n')


@pytest.mark.slow
def test_a_full_disk_for_stdout_gives_one_line(tmp_path: Path) -> None:
    path = write_line(tmp_path / 'path.txt')
    command = [sys.executable, '-m', 'hoid_bringup', 'evaluate', str(path), str(path)]
    with Path('/dev/full').open('w') as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == 'hoid evaluate: [Errno 28] No space left on device\n'


@pytest.mark.slow
def test_a_removed_working_folder_gives_one_line(tmp_path: Path) -> None:
    command = f'"{sys.executable}" -m hoid_bringup'
    argv = ['sh', '-c', f'rmdir ../gone && {command} convert recording bag']
    (tmp_path / 'gone').mkdir()
    done = subprocess.run(argv, cwd=tmp_path / 'gone', capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == 'hoid convert: [Errno 2] No such file or directory\n'
