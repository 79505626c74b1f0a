"""A rendered scene replayed through the real processes: accuracy, and effect of the filter."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bringup import cli
from hoid_common.io.trajectory_io import read_tum
from hoid_synth.bag import write_bag
from hoid_synth.config import SceneConfig

pytestmark = [pytest.mark.thorough, pytest.mark.alone]

FRAMES = 75  # two people walk past, close to the camera


@pytest.fixture(scope='module')
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('a scene') / 'scene.bag'
    write_bag(SceneConfig(num_frames=FRAMES), path, workers=2)
    return path


def replay(scene: Path, out: Path, *options: str) -> dict[str, Any]:
    argv = ['replay', str(scene), '--out', str(out), '--lockstep', '--detector', 'truth']
    assert cli.main([*argv, *options]) == 0
    summary: dict[str, Any] = json.loads((out / 'summary.json').read_text())
    return summary


@pytest.mark.usefixtures('domain_id')
def test_the_filter_reduces_the_error_and_no_image_is_lost(scene: Path, tmp_path: Path) -> None:
    filtered = replay(scene, tmp_path / 'with', '--filter', 'hoid2d')
    # The consensus would protect the pose as well.
    no_consensus = '--set', 'slam.tracking.consensus.enabled=false'
    plain = replay(scene, tmp_path / 'without', '--filter', 'none', *no_consensus)
    for summary in (filtered, plain):
        assert summary['frames_total'] == FRAMES
        assert summary['frames_processed'] == FRAMES
    assert filtered['coverage'] >= 0.98
    assert filtered['ate_rmse_m'] < 0.015
    assert filtered['ate_online_rmse_m'] < 0.03
    assert plain['ate_rmse_m'] > 2 * filtered['ate_rmse_m']
    assert filtered['filter']['features_removed'] > 0
    assert filtered['filter']['objects_dynamic'] > 0
    assert plain['filter']['features_removed'] == 0


@pytest.mark.usefixtures('domain_id')
def test_a_replay_agrees_with_the_offline_run(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    live = replay(scene, tmp_path / 'live', '--filter', 'hoid2d')
    assert 'ground-truth boxes' in capsys.readouterr().out
    argv = ['run', str(scene), '--out', str(tmp_path / 'offline'), '--detector', 'truth']
    assert cli.main([*argv, '--filter', 'hoid2d']) == 0
    offline = json.loads((tmp_path / 'offline' / 'summary.json').read_text())
    assert live['ate_rmse_m'] <= max(1.5 * offline['ate_rmse_m'], 0.01)
    for name in ('trajectory.txt', 'trajectory_online.txt'):
        trajectory = read_tum(tmp_path / 'live' / name)
        assert set(trajectory.stamps_ns) <= set(BagSequence(scene).depth_of_color)
        assert len(trajectory) == live['frames_tracked']
    assert len(read_tum(tmp_path / 'live' / 'keyframes.txt')) == live['keyframes'] > 2
    assert live['map_points'] > 300
    ply = (tmp_path / 'live' / 'map.ply').read_bytes()
    assert f'element vertex {live["map_points"]}\n'.encode() in ply
    assert set(live['stage_ms']) >= {'extract', 'filter', 'track', 'frame'}
    assert 0 < live['latency_ms']['median'] < 2000
    assert (tmp_path / 'live' / 'logs' / 'rgbd_slam.log').exists()
    assert not list((tmp_path / 'live').glob('.*'))


@pytest.mark.usefixtures('domain_id')
def test_a_node_that_cannot_start_ends_the_replay_with_its_message(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = ['replay', str(scene), '--out', str(tmp_path / 'out'), '--detector', 'nowhere.onnx']
    assert cli.main(argv) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith('hoid replay: hoid_detector refused to start: ')
    assert 'nowhere.onnx' in error
    assert not (tmp_path / 'out' / 'summary.json').exists()
