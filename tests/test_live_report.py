"""`hoid bench live` measures every process of running nodes."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hoid_benchmarks.live.cases import LiveCase
from hoid_benchmarks.live.live_case import PROCESSES, LiveResult
from hoid_benchmarks.live.live_report import table_rows
from hoid_benchmarks.live.usage import Usage, UsageMeter

_LIMIT_S = 600  # enough for a busy machine
_NUM_SLEEPS = 40
# A row of one process: CPU s/s, CPU ms/image, PSS MB, wake-ups /s.
_ROW = re.compile(r'\| (\w+) \| ([\d.]+) \| ([\d.]+) \| (\d+) \| (\d+) \| ([^|]*) \| ([^|]*) \|$')


def test_a_meter_counts_processor_time_memory_and_wake_ups() -> None:
    meter, start_s, cpu_s = (
        UsageMeter({'self': os.getpid()}),
        time.monotonic(),
        time.process_time(),
    )
    while time.process_time() < cpu_s + 0.3:
        pass
    for _ in range(_NUM_SLEEPS):
        time.sleep(1e-3)
    (usage,) = meter.read().values()
    elapsed_s = time.monotonic() - start_s
    spent_s = time.process_time() - cpu_s
    assert abs(usage.cpu * elapsed_s - spent_s) < 0.05  # the kernel counts in steps of 10 ms
    assert usage.wake_ups_hz * elapsed_s >= 0.9 * _NUM_SLEEPS
    assert 10 < usage.pss_mb < 10_000


def test_a_process_that_has_ended_is_left_out() -> None:
    process = subprocess.Popen([sys.executable, '-c', 'input()'], stdin=subprocess.PIPE)
    meter = UsageMeter({'short': process.pid, 'self': os.getpid()})
    process.communicate(b'\n')
    assert meter.read().keys() == {'self'}


def test_the_table_has_the_sum_and_each_process() -> None:
    usage = {'rgbd_slam': Usage(0.25, 100.4, 50.2), 'hoid_filter': Usage(0.5, 99.8, 30.0)}
    result = LiveResult(usage, (12.4, 30.6), 240, 300, 10.0)
    case = LiveCase('recording', everything=False, rate_hz=30.0)
    first, *others = table_rows('pose', case, result)
    assert first == [
        *('pose', 'hoid+', 'odometry', '2', '30', 'all'),
        *('0.75', '31.2', '200', '80', '12 / 31', '80 %'),
    ]
    assert [row[5:9] for row in others] == [
        ['hoid_filter', '0.50', '20.8', '100'],
        ['rgbd_slam', '0.25', '10.4', '100'],
    ]


@pytest.mark.thorough
@pytest.mark.alone
def test_the_report_has_every_process_of_a_rendered_scene(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, '-m', 'hoid_bringup', 'bench', 'live', '--quick', '--out', tmp_path],
        capture_output=True, text=True, timeout=_LIMIT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    rows = [match.groups() for line in done.stdout.splitlines() if (match := _ROW.search(line))]
    total, *processes = rows
    assert total[0] == 'all'
    assert [row[0] for row in processes] == list(PROCESSES)
    assert all(float(row[1]) > 0 and int(row[3]) > 10 for row in processes)
    assert float(total[1]) == pytest.approx(sum(float(row[1]) for row in processes), abs=0.05)
    median_ms, p95_ms = (float(text) for text in total[5].split('/'))
    assert 1 < median_ms <= p95_ms
    assert int(total[6].removesuffix(' %')) > 0
    assert 'load average' in done.stdout


def test_an_unknown_case_is_refused(tmp_path: Path) -> None:
    words = ['bench', 'live', '--only', 'nowhere', '--out', str(tmp_path)]
    done = subprocess.run(
        [sys.executable, '-m', 'hoid_bringup', *words],
        capture_output=True, text=True, timeout=_LIMIT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.startswith('hoid bench: no case nowhere: all, pose,')
