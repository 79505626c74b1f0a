"""`hoid bench official` as a process, on rendered scenes in the layout of the official ones."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hoid_synth.config import SceneConfig
from hoid_system_tests.official_folder import write_official_folder

pytestmark = pytest.mark.thorough

_LIMIT_S = 900  # enough for a busy machine
_WORDS = ('--only', 'table_3', '--detector', 'synthetic', '--workers', '1')
_FRAMES = 16


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('official sequences')
    scene = SceneConfig(seed=5, num_frames=_FRAMES, path='xyz')
    tum = folder / 'rgbd_dataset_freiburg3_walking_xyz'
    write_official_folder(tum / tum.name, scene, 1341846313.553992, 6, lost=(5, 6, 7))
    bonn = folder / 'rgbd_bonn_dataset' / 'rgbd_bonn_crowd'
    write_official_folder(bonn, scene, 1548339856.13476, 5)
    (folder / 'rgbd_dataset_freiburg3_walking_static.tgz').touch()
    return folder


def hoid_bench(folder: Path, *words: str) -> subprocess.Popen[str]:
    # A shell starts background jobs with SIGINT ignored, and child processes inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    command = [sys.executable, '-m', 'hoid_bringup', 'bench', 'official', '.', '--out', 'out']
    return subprocess.Popen(
        [*command, *_WORDS, *words],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip


def finished(folder: Path) -> dict[str, int]:
    """Return the modification time [ns] of each result file, by run."""
    found = (folder / 'out' / 'official' / 'runs').glob('*/result.json')
    return {path.parent.name: path.stat().st_mtime_ns for path in found}


def stop_after(number: int, folder: Path) -> None:
    """Start, and interrupt as soon as there are so many results."""
    running = hoid_bench(folder)
    end_s = time.monotonic() + _LIMIT_S
    while len(finished(folder)) < number and running.poll() is None:
        assert time.monotonic() < end_s
        time.sleep(0.05)
    running.send_signal(signal.SIGINT)
    _, errors = running.communicate(timeout=_LIMIT_S)
    assert running.returncode == 130, errors


def test_an_interrupted_comparison_is_resumed_and_its_tables_are_printed(folder: Path) -> None:
    stop_after(2, folder)
    before = finished(folder)
    stop_after(8, folder)  # the first run of two sequences with four filters
    assert before.items() <= finished(folder).items()
    report = hoid_bench(folder, '--report')
    output, errors = report.communicate(timeout=_LIMIT_S)
    assert report.returncode == 0, errors
    found, packed, lacking = output.splitlines()[:3]
    assert found == 'found: bonn_crowd, fr3_walking_xyz'
    assert packed == 'not unpacked: rgbd_dataset_freiburg3_walking_static.tgz'
    assert 'freiburg3_walking_halfsphere' in lacking
    assert 'freiburg3_walking_xyz' not in lacking
    rows = re.findall(r'^\| (?:TUM|Bonn) `(\w+)` \| (.*) \| ([\d.]+) \| ([\d.]+) \|', output, re.M)
    assert [row[:2] for row in rows] == [
        ('fr3_walking_xyz', '0.721 (ORB-SLAM2, published)'),
        ('crowd', ''),
    ]
    # The scene is followed: the camera moves by several centimeters.
    assert all(float(error_m) < 0.01 for row in rows for error_m in row[2:])
    cells = {line.split(' | ')[0]: line for line in output.splitlines() if '| 1.000 |' in line}
    assert set(cells) >= {'| fr3_walking_xyz', '| bonn_crowd'}
