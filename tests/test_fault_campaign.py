"""A quick fault campaign, in which every case has the expected outcome, and its parts."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hoid_benchmarks.faults.cases import Outcome, merged, table
from hoid_benchmarks.faults.damage import damaged
from hoid_benchmarks.faults.models import ConstantModel
from hoid_common.errors import ModelError
from hoid_detector.config import DetectorConfig
from hoid_detector.onnx_detector import OnnxDetector

pytestmark = pytest.mark.thorough

SEED = 1
LIMIT_S = 300.0  # takes a third of it on an idle machine


@pytest.mark.alone
@pytest.mark.usefixtures('domain_id')
def test_all_cases_of_a_quick_campaign_pass(tmp_path: Path) -> None:
    command = (
        'bench', 'faults', '--quick', '--seed', str(SEED), '--out', str(tmp_path / 'out'),
    )  # fmt: skip
    done = subprocess.run(
        [sys.executable, '-m', 'hoid_bringup', *command],
        capture_output=True, text=True, timeout=LIMIT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr + (tmp_path / 'out/faults/faults.md').read_text()
    rows = [line for line in done.stdout.splitlines() if line.startswith('| ')]
    assert len(rows) == 1 + 23 + 2 + 15 + 7  # head; files, kills; inputs, conditions


def test_damage_depends_on_the_seed_and_changes_the_data() -> None:
    data = bytes(range(256)) * 20
    for seed in range(200):
        one, other = (damaged(data, np.random.default_rng(seed)) for _ in range(2))
        assert one == other
        assert one != data
    assert damaged(b'', np.random.default_rng(0)) == b''


def test_hanging_crashing_and_printing_children_are_distinguished() -> None:
    code = (
        'import os, sys, time\n'
        'from hoid_benchmarks.faults.guarded import run_guarded\n'
        'late = run_guarded(lambda: time.sleep(60) or 0, 0.3)\n'
        'assert late.was_killed and late.status == -9, late\n'
        'raised = run_guarded(lambda: 1 // 0, 10)\n'
        'assert raised.status == 99 and "ZeroDivisionError" in raised.stderr, raised\n'
        'said = run_guarded(lambda: sys.stderr.write("hello") and 3, 10)\n'
        'assert (said.status, said.stderr) == (3, "hello"), said\n'
    )
    subprocess.run([sys.executable, '-c', code], check=True, timeout=60)


@pytest.mark.parametrize('model', [ConstantModel(output='\udcff'), ConstantModel(names='\udcff')])
def test_a_model_with_invalid_utf8_is_refused(tmp_path: Path, model: ConstantModel) -> None:
    path = tmp_path / 'model.onnx'
    path.write_bytes(model.data())
    with pytest.raises(ModelError, match='is no usable ONNX model'):
        OnnxDetector(path, DetectorConfig())


def test_the_table_names_failed_cases() -> None:
    outcomes = [Outcome('bag', 1, ''), Outcome('bag', 2, 'it hung', wall_s=10.0)]
    text = table(outcomes)
    assert '| bag | 2 | 1 | 0 | 5.0 s | 10.0 s | - | - |' in text
    assert text.endswith('- bag, seed 2: it hung\n')


def test_a_later_table_replaces_rows_of_the_same_kind() -> None:
    before = table([Outcome('bag', 1, ''), Outcome('names', 1, '')])
    after = table([Outcome('bag', 2, '', number=40), Outcome('disk', 2, '')])
    lines = merged(before, after).splitlines()
    assert [line.split()[1] for line in lines[2:]] == ['bag', 'names', 'disk']
    assert '| bag | 40 | 40 |' in lines[2]
    assert merged('', after) == after
