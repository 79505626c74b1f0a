"""Output that nobody reads does not block a process; nothing else is lost."""

from __future__ import annotations

import os
import pty
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

NUM_LINES = 40_000
LINES = f"""
import sys
from pathlib import Path
from hoid_common.process.output import relay_output
relay_output()
for i in range({NUM_LINES}):
    sys.stderr.write(f'line {{i:05d}} of some length, as those of a log are\\n')
Path(sys.argv[1]).write_text('done')
sys.stdin.readline()
print('the last words')
"""
DYING = """
import os, signal, sys
from hoid_common.process.output import relay_output
relay_output()
print('out', flush=True)
os.write(2, b'err without an end')
os.kill(os.getpid(), signal.SIGKILL)
"""
NUM_CHILDREN = """
import subprocess, sys
from hoid_common.process.output import relay_output
code = 'import psutil; from hoid_common.process.output import relay_output; relay_output();'
code += 'print(len(psutil.Process().children()))'
if 'outer' in sys.argv:
    relay_output()
subprocess.run([sys.executable, '-c', code], check=True)
"""
LIMIT_S = 60
COMPLETE = re.compile(rb'^line (\d{5}) of some length, as those of a log are$', re.MULTILINE)
DROPPED = re.compile(rb'\[(\d+) lines of output were dropped: nobody read them in time\]')


def check_lines(output: bytes) -> None:
    """Check that lines are in order, and that all missing ones were counted."""
    # A line may have been written in part before its rest was dropped, which counts as dropped.
    numbers = [int(number) for number in COMPLETE.findall(output)]
    assert numbers == sorted(numbers)
    dropped = sum(map(int, DROPPED.findall(output)))
    assert dropped > NUM_LINES // 2
    assert len(numbers) + dropped == NUM_LINES
    assert output.endswith(b'\nthe last words\n')
    assert numbers[-1] == NUM_LINES - 1


def test_a_full_pipe_does_not_block_and_lost_lines_are_counted(tmp_path: Path) -> None:
    pipe = subprocess.PIPE
    argv = [sys.executable, '-c', LINES, str(tmp_path / 'done')]
    with subprocess.Popen(argv, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT) as process:
        assert process.stdin is not None
        await_file(tmp_path / 'done', process)
        output, _ = process.communicate(b'\n', timeout=LIMIT_S)
    assert process.returncode == 0
    check_lines(output)


def test_a_full_socket_does_not_block(tmp_path: Path) -> None:
    ours, theirs = socket.socketpair()  # as the output of a service of systemd
    argv = [sys.executable, '-c', LINES, str(tmp_path / 'done')]
    err, pipe = subprocess.STDOUT, subprocess.PIPE
    with ours, subprocess.Popen(argv, stdin=pipe, stdout=theirs.fileno(), stderr=err) as process:
        theirs.close()
        await_file(tmp_path / 'done', process)
        assert process.stdin is not None
        process.stdin.write(b'\n')
        process.stdin.close()
        output = b''
        while part := ours.recv(1 << 16):
            output += part
    check_lines(output)


def test_a_stopped_terminal_does_not_block(tmp_path: Path) -> None:
    ours, theirs = pty.openpty()  # of which nobody reads, as after Ctrl-S
    argv = [sys.executable, '-c', LINES, str(tmp_path / 'done')]
    with subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=theirs, stderr=theirs) as process:
        await_file(tmp_path / 'done', process)
        process.communicate(b'\n', timeout=LIMIT_S)
    os.close(theirs)
    os.close(ours)
    assert process.returncode == 0


def test_the_output_of_a_killed_process_arrives() -> None:
    argv = [sys.executable, '-c', DYING]
    done = subprocess.run(argv, capture_output=True, timeout=LIMIT_S, check=False)
    assert done.returncode == -signal.SIGKILL
    assert (done.stdout, done.stderr) == (b'out\n', b'err without an end')


def test_output_is_relayed_once_and_files_are_left_alone(tmp_path: Path) -> None:
    def num_relays(*arguments: str) -> str:
        argv = [sys.executable, '-c', NUM_CHILDREN, *arguments]
        return subprocess.run(
            argv, capture_output=True, text=True, timeout=LIMIT_S, check=True
        ).stdout

    assert num_relays() == '1\n'
    assert num_relays('outer') == '0\n'
    with (tmp_path / 'log').open('w') as log:
        argv = [sys.executable, '-c', NUM_CHILDREN]
        subprocess.run(argv, stdout=log, stderr=log, timeout=LIMIT_S, check=True)
    assert (tmp_path / 'log').read_text() == '0\n'


def await_file(path: Path, process: subprocess.Popen[bytes]) -> None:
    """Wait until a process has created a file."""
    code = f'import os, time\nwhile not os.path.exists({str(path)!r}): time.sleep(0.01)'
    subprocess.run([sys.executable, '-c', code], timeout=LIMIT_S, check=True)
    assert process.poll() is None
