"""The pose follows the static room while a rendered group walks past undetected."""

import json
from pathlib import Path
from typing import Any

import pytest

from hoid_bringup import cli
from hoid_synth.bag import write_bag
from hoid_synth.config import SceneConfig

pytestmark = pytest.mark.thorough

FRAMES = 45
GROUP = SceneConfig(
    seed=1, path='xyz', num_people=3, near_m=1.2, together=True, num_frames=FRAMES, width_px=320
)


@pytest.fixture(scope='module')
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('a group') / 'scene.bag'
    write_bag(GROUP, path, workers=2)
    return path


def run(scene: Path, out: Path, *options: str) -> dict[str, Any]:
    assert cli.main(['run', str(scene), '--out', str(out), '--filter', 'none', *options]) == 0
    summary: dict[str, Any] = json.loads((out / 'summary.json').read_text())
    assert summary['frames_total'] == FRAMES
    assert summary['coverage'] == 1.0
    return summary


def test_undetected_people_do_not_capture_the_pose(scene: Path, tmp_path: Path) -> None:
    """Without the consensus they do in this scene, because every match counts alike."""
    assert run(scene, tmp_path / 'consensus')['ate_rmse_m'] < 0.015
    captured = run(scene, tmp_path / 'all', '--set', 'slam.tracking.consensus.enabled=false')
    assert captured['ate_rmse_m'] > 0.03


def test_runs_repeat_bit_for_bit(scene: Path, tmp_path: Path) -> None:
    for name in ('once', 'again'):
        run(scene, tmp_path / name)
    once, again = ((tmp_path / name / 'trajectory.txt').read_bytes() for name in ('once', 'again'))
    assert once == again
