"""`hoid bench` as a process: it resumes after a stop, repeats its tables and reports all runs."""

from __future__ import annotations

import csv
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from hoid_system_tests.browser import headless_browser, shown_on_a_phone

pytestmark = pytest.mark.thorough

PLAN = """
experiments:
  - id: compare
    title: None against HOID
    view: comparison
    sequences: [synth-5-frames=16+width=320, fr3_walking_xyz]
    filters: [none, hoid2d]
    detectors: [truth]
    seeds: [0]
  - id: stages
    title: Times
    view: stages
    sequences: [synth-5-frames=16+width=320]
    filters: [hoid2d]
    detectors: [truth, nowhere.onnx]
    seeds: [0]
"""
_LIMIT_S = 900  # enough for a busy machine
_TIMED = re.compile(r'\[(ms|MB)\]')


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('bench')
    (folder / 'tiny.yaml').write_text(PLAN)
    return folder


def start(folder: Path, out: str) -> subprocess.Popen[str]:
    words = ['bench', 'tiny.yaml', '--out', out, '--workers', '1']
    # A shell starts background jobs with SIGINT ignored, and child processes inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    return subprocess.Popen(
        [sys.executable, '-m', 'hoid_bringup', *words],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip


def finish(folder: Path, out: str) -> str:
    running = start(folder, out)
    output, errors = running.communicate(timeout=_LIMIT_S)
    assert running.returncode == 0, errors
    return output


def results(folder: Path, out: str) -> dict[str, int]:
    """Return the modification time [ns] of each result file, by run."""
    found = (folder / out / 'tiny' / 'runs').glob('*/result.json')
    return {path.parent.name: path.stat().st_mtime_ns for path in found}


def stop_after(number: int, sent: signal.Signals, folder: Path, out: str) -> tuple[int, str]:
    """Start, stop after `number` results; return the status and the last line of the errors."""
    running = start(folder, out)
    end_s = time.monotonic() + _LIMIT_S
    while len(results(folder, out)) < number and running.poll() is None:
        assert time.monotonic() < end_s
        with suppress(subprocess.TimeoutExpired):
            running.wait(0.02)
    os.kill(running.pid, sent)
    _, errors = running.communicate(timeout=_LIMIT_S)
    return running.returncode, errors.strip().splitlines()[-1]


@pytest.fixture(scope='module')
def first_done(folder: Path) -> str:
    """Stop the experiments twice; return the output of the call that finishes them."""
    status, line = stop_after(1, signal.SIGINT, folder, 'one')
    assert (status, line) == (130, 'hoid bench: interrupted')
    before = results(folder, 'one')
    assert before
    stop_after(2, signal.SIGKILL, folder, 'one')
    output = finish(folder, 'one')
    # Existing results are not computed again.
    assert before.items() <= results(folder, 'one').items()
    return output


def table(folder: Path, out: str, name: str) -> list[list[str]]:
    with (folder / out / 'tiny' / 'tables' / f'{name}.csv').open() as file:
        rows = list(csv.reader(file))
    kept = [k for k, column in enumerate(rows[0]) if not _TIMED.search(column)]
    return [[row[k] for k in kept] for row in rows]


def test_stopped_experiments_are_resumed(folder: Path, first_done: str) -> None:
    assert '2 runs done, 1 failed, 2 of sequences that are not here' in first_done
    page = (folder / 'one' / 'tiny' / 'index.html').read_text()
    assert 'synth-5-frames=16+width=320' in page
    figures = {p.suffix for p in (folder / 'one' / 'tiny' / 'figures').iterdir()}
    assert figures == {'.png', '.svg'}


def test_the_results_page_works_in_a_browser(folder: Path, first_done: str) -> None:
    assert first_done
    url = (folder / 'one' / 'tiny' / 'index.html').as_uri()
    with headless_browser() as browser, shown_on_a_phone(browser, url) as page:
        strategies = page.locator('#table-compare tbody td:nth-child(2)')
        assert strategies.all_inner_texts() == ['none', 'hoid2d']
        page.locator('#table-compare th button').nth(1).click()
        assert strategies.all_inner_texts() == ['hoid2d', 'none']
        paths = page.locator('#compare .plot').first.locator('.scatterlayer .trace')
        assert paths.count() == 3  # the ground truth and two filters
        command = page.locator('.facts dd').first.inner_text()
        assert command.endswith(f'{folder.name}/one')
        assert '/tiny.yaml --out ' in command


def test_failed_and_missing_runs_are_rows_with_the_reason(folder: Path, first_done: str) -> None:
    assert first_done
    assert 'nowhere.onnx' in table(folder, 'one', 'failures')[1][1]
    (row,) = table(folder, 'one', 'missing')[1:]
    assert row[0] == 'fr3_walking_xyz'
    assert 'rgbd_dataset_freiburg3_walking_xyz' in row[1]


def test_repeated_experiments_give_equal_tables_except_for_times(
    folder: Path, first_done: str
) -> None:
    assert first_done
    (folder / 'two').mkdir()
    (folder / 'two' / 'sequences').symlink_to(folder / 'one' / 'sequences')
    finish(folder, 'two')
    for name in ('compare', 'stages', 'failures', 'missing'):
        assert table(folder, 'one', name) == table(folder, 'two', name)
