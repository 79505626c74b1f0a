from __future__ import annotations

import fcntl
import os
import signal
import struct
import subprocess
import sys
import termios
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from hoid_bringup import cli
from hoid_common.io.trajectory_io import write_tum
from hoid_common.values import Trajectory


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
def test_wrong_usage_is_status_2(argv: list[str]) -> None:
    with pytest.raises(SystemExit) as exit_info:
        cli.main(argv)
    assert exit_info.value.code == 2


@pytest.mark.parametrize('command', ['run', 'replay', 'view', 'pictures'])
def test_an_unknown_strategy_is_wrong_usage_in_every_command(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as exit_info:
        cli.main([command, 'SEQUENCE', '--out', 'DIR', '--filter', 'bogus'])
    assert exit_info.value.code == 2
    assert "--filter: invalid choice: 'bogus'" in capsys.readouterr().err


def test_interruption_is_status_130(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def interrupted(_path: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr('hoid_bringup.commands.read_tum', interrupted)
    assert cli.main(['evaluate', str(tmp_path), str(tmp_path)]) == 130


def unread_bytes(pipe: int) -> int:
    (count,) = struct.unpack('i', fcntl.ioctl(pipe, termios.FIONREAD, bytes(4)))
    return int(count)


def test_sigterm_ends_a_command_as_ctrl_c_does(tmp_path: Path) -> None:
    fifo = tmp_path / 'endless.txt'
    os.mkfifo(fifo)
    argv = [sys.executable, '-m', 'hoid_bringup', 'evaluate', str(fifo), str(fifo)]
    process = subprocess.Popen(argv, stderr=subprocess.PIPE, text=True)
    with process, fifo.open('w') as writer:
        writer.write('# of more that never comes\n')
        writer.flush()
        while unread_bytes(writer.fileno()):  # until the command is within reading
            time.sleep(0.01)
        while process.poll() is None:  # a signal just before the next read begins is lost to it
            process.send_signal(signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                process.wait(timeout=10)
        _, said = process.communicate(timeout=10)
    assert process.returncode == 130
    assert said == 'hoid evaluate: interrupted\n'
