from __future__ import annotations

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from subprocess import run

import cv2
import numpy as np
import pytest

from hoid_bringup import cli
from hoid_bringup.commands import dropped_frames, run_report
from hoid_bringup.run.outputs import write_outputs
from hoid_bringup.run.provenance import Provenance, commit
from hoid_bringup.run.summary import FilterCounts, RunResult, Spread, summarize
from hoid_common.errors import InputError
from hoid_common.io.files import staged
from hoid_common.io.tum_text import read_tum, write_tum
from hoid_common.slam_status import SlamState, SlamStatus
from hoid_common.values import Trajectory

CONTRACT = """frames_total frames_processed frames_tracked coverage ate_rmse_m ate_online_rmse_m
    frames_in_other_maps maps merges
    rpe_trans_1s_rmse_m rpe_rot_1s_rmse_deg keyframes map_points loops relocalizations
    stage_ms latency_ms peak_rss_mb filter made_by versions"""


def spiral(n: int) -> Trajectory:
    T = np.tile(np.eye(4), (n, 1, 1))
    s = 0.06 * np.arange(n)
    T[:, :3, 3] = np.stack([np.cos(s), np.sin(s), 0.1 * s], axis=1)
    return Trajectory(10**18 + 33_333_333 * np.arange(n), T)


def result(final: Trajectory, truth: Trajectory | None) -> RunResult:
    return RunResult(
        input_name='spiral',
        options={'filter': 'none', 'seed': 0},
        frames_total=100,
        frames_processed=100,
        final=final,
        online=final,
        keyframes=Trajectory(final.stamps_ns[::10], final.T_world_camera[::10]),
        map_points_m=np.array([[1.0, 2, 3], [4, 5, 6]]),
        ground_truth=truth,
        status=SlamStatus(SlamState.TRACKING, keyframes=9, map_points=2, maps=1, loops=1),
        filter_counts=FilterCounts(100_000, 20, 3),
        stage_ms={'frame': [1.0, 2, 3], 'rest': [4.0]},
        peak_rss_mb=321.04,
        recording=Path('spiral.bag'),
    )


def test_all_files_of_the_contract(tmp_path: Path) -> None:
    out = tmp_path / 'a run' / 'deep'
    summary = write_outputs(out, result(spiral(90), spiral(100)))
    assert summary.coverage == 0.9
    assert summary.ate_rmse_m == 0.0
    assert sorted(p.name for p in out.iterdir()) == [
        'keyframes.txt',
        'map.ply',
        'summary.json',
        'trajectory.png',
        'trajectory.txt',
        'trajectory_online.txt',
    ]
    loaded = json.loads((out / 'summary.json').read_text())
    assert loaded['recording'] == str(Path.cwd() / 'spiral.bag')
    assert set(CONTRACT.split()) <= set(loaded)
    nothing = dict.fromkeys(('detect', 'extract', 'filter', 'track', 'map'))
    assert loaded['stage_ms'] == {
        **nothing,
        'frame': {'median': 2.0, 'p95': 2.9},
        'rest': {'median': 4.0, 'p95': 4.0},
    }
    assert loaded['filter'] == {
        'features_in': 100_000,
        'features_removed': 20,
        'objects_dynamic': 3,
    }
    assert loaded['latency_ms'] is None
    assert len(read_tum(out / 'trajectory.txt')) == 90
    picture = cv2.imread(str(out / 'trajectory.png'))
    assert picture is not None
    assert picture.shape[1] > 1000
    ply = (out / 'map.ply').read_bytes()
    assert b'element vertex 2\n' in ply
    assert np.frombuffer(ply[-24:], '<f4').tolist() == [1, 2, 3, 4, 5, 6]


def test_evaluate_calls_coverage_what_the_run_called_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_outputs(tmp_path, result(spiral(90), spiral(100)))
    write_tum(tmp_path / 'truth.txt', spiral(100))
    argv = ['evaluate', str(tmp_path / 'trajectory.txt'), str(tmp_path / 'truth.txt')]
    assert cli.main(argv) == 0
    assert 'coverage 90.0 %' in capsys.readouterr().out
    assert cli.main([*argv, '--frames', '120']) == 0
    assert 'coverage 75.0 %' in capsys.readouterr().out


@pytest.mark.parametrize('num_tracked', [0, 2])
def test_a_run_that_tracked_nothing_has_null_errors(tmp_path: Path, num_tracked: int) -> None:
    summary = write_outputs(tmp_path, result(spiral(num_tracked), spiral(100)))
    assert summary.ate_rmse_m is None
    assert summary.frames_tracked == num_tracked


def test_ground_truth_of_another_time_gives_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    truth = spiral(100)
    late = Trajectory(truth.stamps_ns + 10**12, truth.T_world_camera)
    assert write_outputs(tmp_path, result(spiral(90), late)).ate_rmse_m is None
    (record,) = caplog.records
    assert 'share 0 poses' in record.getMessage()
    assert 'of the same recording?' in record.getMessage()


@pytest.mark.slow
def test_without_ground_truth_errors_are_null(tmp_path: Path) -> None:
    write_outputs(tmp_path, result(spiral(90), None))
    loaded = json.loads((tmp_path / 'summary.json').read_text())
    assert loaded['ate_rmse_m'] is None
    assert loaded['rpe_rot_1s_rmse_deg'] is None


def write_until_full(out_dir: Path) -> None:
    with staged(out_dir) as stage:
        (stage / 'new.txt').write_text('half')
        raise OSError(28, 'No space left on device')


def test_a_full_disk_leaves_no_files(tmp_path: Path) -> None:
    (tmp_path / 'old.txt').write_text('kept')
    with pytest.raises(InputError, match='No space left'):
        write_until_full(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ['old.txt']


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / 'out').write_text('')
    with pytest.raises(InputError, match='out: cannot be written'):
        write_outputs(tmp_path / 'out', result(spiral(9), None))


def test_spread() -> None:
    assert Spread.of([3.0, 1.0, 2.0]) == Spread(2.0, 2.9)
    assert Spread.of([]) is None


@pytest.mark.parametrize(
    ('options', 'detector'),
    [
        ({'filter': 'motion'}, None),
        ({'filter': 'hoid+', 'detector.model': 'truth'}, ('truth', None)),
        ({'filter': 'hoid+', 'detector.model': 'gone.onnx'}, None),
        ({'filter': 'hoid2d', 'detector.model': 'own.onnx'}, ('own', sha256(b'own').hexdigest())),
    ],
)
def test_a_result_names_its_detector_code_and_machine(
    options: dict[str, str], detector: tuple[str, str | None] | None, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path('own.onnx').write_bytes(b'own')
    made_by = Provenance.of_this_process(options)
    found = made_by.detector
    assert (None if found is None else (found.name, found.sha256)) == detector
    assert made_by.command
    assert 'cores' in made_by.machine


def test_a_clone_has_a_commit_that_says_whether_files_differ(tmp_path: Path) -> None:
    assert commit(tmp_path) == ''
    git = ['git', '-C', str(tmp_path), '-c', 'user.name=a', '-c', 'user.email=a@localhost']
    (tmp_path / 'file').write_text('one')
    for command in (['init', '-q'], ['add', '.'], ['commit', '-q', '-m', 'first']):
        run([*git, *command], check=True)
    clean = commit(tmp_path)
    assert len(clean) >= 7
    (tmp_path / 'file').write_text('two')
    assert commit(tmp_path) == f'{clean}-dirty'


def test_a_replay_says_how_many_frames_were_dropped_and_why() -> None:
    every = summarize(result(spiral(90), None))
    assert dropped_frames(every) == ''
    some = replace(every, frames_processed=93, cpu_share_by_node={'a': 0.75, 'b': 0.5})
    text = dropped_frames(some)
    assert text.startswith('7 frames, which arrived while earlier ones were processed')
    assert 'the nodes got 1.2 of ' in text
    assert f'dropped    {text}' in run_report(some, Path('out')).splitlines()
