"""`hoid demo` on a rendered scene, and on a camera that a played bag replaces."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_synth.bag import write_bag
from hoid_synth.config import SceneConfig
from hoid_system_tests.documented import ROOT, shape, shown_commands

pytestmark = [pytest.mark.thorough, pytest.mark.alone]
SECONDS, LIMIT_S = 2, 300
HOID = (sys.executable, '-m', 'hoid_bringup')


@pytest.mark.usefixtures('domain_id')
def test_the_demo_prints_the_output_shown_in_readme(tmp_path: Path) -> None:
    (expected,) = (
        shape(shown.output)
        for shown in shown_commands(ROOT / 'README.md')
        if shown.command == 'make demo'
    )
    done = subprocess.run(
        [*HOID, 'demo', '--frames', '30'],
        cwd=tmp_path, capture_output=True, text=True, timeout=LIMIT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(expected) > 5
    assert shape(done.stdout.splitlines())[-len(expected) :] == expected
    assert cv2.imread(str(tmp_path / 'out/demo/demo.png')) is not None


@pytest.mark.usefixtures('domain_id')
def test_the_demo_records_a_camera_and_draws_its_picture(tmp_path: Path) -> None:
    played = tmp_path / 'camera.bag'
    write_bag(SceneConfig(seed=1, num_frames=45, path='xyz', num_people=1), played, 2)
    topics = ('rgb/image', 'depth/image', 'rgb/camera_info')
    player = subprocess.Popen([*HOID, 'play', played, '--loop', '--no-clock', '--topics', *topics])
    try:
        words = ('demo', '--camera', 'bag', '--seconds', str(SECONDS), '--out', 'out')
        done = subprocess.run(
            [*HOID, *words, '--detector', 'synthetic'],
            cwd=tmp_path, capture_output=True, text=True, timeout=LIMIT_S, check=False,
        )  # fmt: skip
    finally:
        player.terminate()
        player.wait(30)
    assert done.returncode == 0, done.stderr
    assert (
        '1/5  recording 2 s of rgb/image, depth/image, rgb/camera_info: look around' in done.stdout
    )
    recorded = BagSequence(tmp_path / 'out/scene.bag')
    assert recorded.ground_truth is None
    assert len(recorded) >= 0.5 * 30 * SECONDS
    picture = cv2.imread(str(tmp_path / 'out/demo.png'))
    assert picture is not None
    assert picture.shape[1] == 1200
    assert (tmp_path / 'out/demo.webp').stat().st_size > 10_000
    (tracked,) = (line for line in done.stdout.splitlines() if line.startswith('frames tracked'))
    *offline, live = (int(word) for word in tracked.split()[2::3])
    assert offline == [len(recorded)] * 3
    assert live >= 0.3 * len(recorded)  # player and nodes share the machine
