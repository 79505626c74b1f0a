"""Commands answer wrong input with one line that names the cause, status 1 and no new file."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.storage.bag_types import IMU
from hoid_bringup import cli
from hoid_common import se3
from hoid_common.io.tum_text import write_tum
from hoid_common.values import Trajectory

STAMPS_S = (1.0, 1.1, 1.2)
OUT = ('--out', 'new')
FR3 = ('run', 'fr3_room', *OUT)


def write_lists(folder: Path, *kinds: str) -> None:
    """Write the lists of a TUM folder, and empty image files, which are never opened."""
    for kind in kinds:
        (folder / kind).mkdir(parents=True)
        rows = [f'{stamp_s} {kind}/{stamp_s}.png\n' for stamp_s in STAMPS_S]
        (folder / f'{kind}.txt').write_text(''.join(rows))
        for row in rows:
            (folder / row.split()[1]).write_bytes(b'')


def write_path(path: Path, start_ns: int) -> None:
    twists = 0.01 * np.random.default_rng(0).standard_normal((9, 6)).cumsum(axis=0)
    write_tum(path, Trajectory(start_ns + 10**8 * np.arange(9), se3.exp(twists)))


@pytest.fixture(scope='module')
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with invalid files of each kind."""
    place = tmp_path_factory.mktemp('bad input')
    write_lists(place / 'fr3_room', 'rgb', 'depth')
    write_lists(place / 'fr3_colour_only', 'rgb')
    write_lists(place / 'fr3_cut', 'rgb', 'depth')
    listed = place / 'fr3_cut' / 'rgb.txt'
    listed.write_text(listed.read_text()[:-7])
    for name, text in (('fr3_long', 'x' * 300), ('fr3_steering', '\x1b[2J')):
        write_lists(place / name, 'rgb', 'depth')
        (place / name / 'rgb.txt').write_text(f'1.0 {text}')
    (place / 'empty').mkdir()
    write_lists(place / 'fr3_pipe', 'rgb', 'depth')
    (place / 'fr3_pipe' / 'rgb.txt').unlink()
    for name in ('pipe', 'pipe.mcap', 'fr3_pipe/rgb.txt'):
        os.mkfifo(place / name)
    (place / 'text').write_text('neither a model nor a map nor a folder\n')
    (place / 'list.yaml').write_text('- 1\n')
    write_path(place / 'path.txt', 10**18)
    write_path(place / 'later.txt', 2 * 10**18)
    with BagWriter(place / 'imu_bag') as bag:
        bag.add_topic('imu', IMU)
        bag.write('imu', 1, bag_messages.imu(1, np.zeros(3)))
    (place / 'void_bag').mkdir()
    (place / 'void_bag' / 'metadata.yaml').write_text('rosbag2_bagfile_information:\n')
    return place


CASES = {
    # recordings
    ('run', 'nowhere', *OUT): 'nowhere: no such file or folder',
    ('run', 'empty', *OUT): 'empty: neither a TUM folder (no rgb.txt) nor a bag',
    ('replay', 'empty', *OUT): 'empty: neither a TUM folder (no rgb.txt) nor a bag',
    ('convert', 'empty', 'new'): 'empty/rgb.txt: no such file',
    ('run', 'text', *OUT): 'text: neither a TUM folder',
    ('run', 'fr3_colour_only', *OUT): 'fr3_colour_only/depth.txt: no such file',
    ('run', 'fr3_cut', *OUT): 'fr3_cut/rgb.txt: line 3: lists "rgb/1", which does not exist',
    ('run', 'fr3_long', *OUT): 'no file can have this name',
    ('run', 'fr3_steering', *OUT): 'fr3_steering/rgb.txt: line 1: lists "\\x1b[2J", which does',
    ('run', 'void_bag', *OUT): 'void_bag/metadata.yaml: is not the metadata of a bag',
    ('run', 'imu_bag', *OUT): 'imu_bag: has no color images',
    ('replay', 'imu_bag', *OUT): 'imu_bag: has no color images',
    ('info', 'empty'): 'empty: not a bag',
    ('convert', 'fr3_room', 'imu_bag'): 'imu_bag: exists already',
    (*FR3, '--calibration', 'fr4'): 'camera "fr4": neither fr1, fr2, fr3',
    (*FR3, '--calibration', 'list.yaml'): 'list.yaml: expected a camera_info mapping',
    (*FR3, '--depth-factor', '0'): 'must be positive, got 0',
    # models and maps
    (*FR3, '--detector', 'text'): 'text is no usable ONNX model',
    (*FR3, '--detector', 'yolo99'): 'detector model yolo99 does not exist',
    (*FR3, '--detector', 'truth'): 'has no ground-truth boxes',
    (*FR3, '--filter', 'none', '--map', 'text'): 'text: is no map file',
    (*FR3, '--localize'): '--localize needs --map',
    # parameters
    (*FR3, '--set', 'filter.strategy=magic'): 'filter.strategy must be one of none, person',
    (
        *FR3,
        '--set',
        'min_interaction_area=2',
    ): 'min_interaction_area must be in [0.0, 1.0], got 2.0',
    (*FR3, '--seed', '-1'): 'slam.seed must be at least 0, got -1',
    (*FR3, '--set', 'oops'): 'expected NAME=VALUE',
    (*FR3, '--set', 'filtr.strategy=none'): '"filtr.strategy"; did you mean filter.strategy?',
    (*FR3, '--set', 'filter=none'): '"filter"; did you mean filter.strategy',
    (*FR3, '--set', 'num_features=9'): 'did you mean filter.extraction.num_features?',
    (*FR3, '--set', 'slam.seed.x=1'): 'did you mean slam.seed?',
    ('replay', 'fr3_room', *OUT, '--rate', '0'): 'rate must be in [0.01, 100.0], got 0.0',
    ('nodes', '--params', 'list.yaml'): 'list.yaml: is not a ROS parameter file',
    ('nodes', '--namespace', 'two words'): '--namespace two words: use letters',
    ('record', 'new', '--duration', '-1'): '--duration -1: must be at least 0',
    # output paths
    ('run', 'fr3_room', '--out', 'text/new'): 'text/new: cannot be written: part of this path',
    ('replay', 'fr3_room', '--out', 'text'): 'text: cannot be written: part of this path',
    (*FR3, '--filter', 'none', '--save-map', 'text/map'): 'text: cannot be written: part of',
    ('synth', 'text/new', '--frames', '1'): 'text: cannot be written: part of this path',
    ('nodes', '--filter', 'none', '--log-dir', 'text/logs'): 'text/logs: cannot be written',
    # file names
    (*FR3, '--filter', 'none', '--save-map', ''): '--save-map .: is a folder',
    ('run', 'x' * 5000, *OUT): "input 'xxxx",
    ('run', 'fr3_room', '--out', 'x' * 5000): 'no file can have this name',
    (*FR3, '--calibration', 'x' * 5000): 'no file can have this name',
    (*FR3, '--detector', 'x' * 5000): 'no file can have this name',
    (*FR3, '--filter', 'none', '--save-map', 'x' * 5000): 'no file can have this name',
    ('nodes', '--params', 'x' * 5000): 'no file can have this name',
    ('nodes', '--namespace', 'x' * 5000): 'no file can have this name',
    ('record', 'x' * 5000): 'no file can have this name',
    ('play', 'x' * 5000): 'no file can have this name',
    ('info', 'caf\udce9'): 'not a UTF-8 name',
    ('evaluate', 'path.txt', 'x' * 300): 'no file can have this name',
    # files without an end
    ('evaluate', '/dev/zero', 'path.txt'): '/dev/zero: not a regular file',
    ('evaluate', 'pipe', 'path.txt'): 'pipe: not a regular file',
    ('info', 'pipe.mcap'): 'pipe.mcap: not a regular file',
    ('run', 'fr3_pipe', *OUT): 'fr3_pipe/rgb.txt: not a regular file',
    # trajectories
    ('evaluate', 'nowhere', 'path.txt'): 'nowhere: no such file',
    ('evaluate', 'text', 'path.txt'): (
        'text: no row is usable; line 1: "neither" is not a time in seconds'
    ),
    ('evaluate', 'later.txt', 'path.txt'): 'share 0 poses within 0.02 s',
    ('evaluate', 'path.txt', 'path.txt', '--frames', '5'): 'has 9 poses, but --frames is 5',
    ('evaluate', 'path.txt', 'path.txt', '--json', 'text/new'): 'text/new: cannot be written',
}


@pytest.mark.parametrize(
    ('argv', 'message'), CASES.items(), ids=[' '.join(argv)[:60] for argv in CASES]
)
def test_the_error_is_one_line_that_names_the_cause(
    argv: tuple[str, ...], message: str, place: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(place)
    before = sorted(place.rglob('*'))
    assert cli.main(argv) == 1
    (line,) = (text for text in capfd.readouterr().err.splitlines() if '%|' not in text)
    assert line.startswith(f'hoid {argv[0]}: ')
    assert message in line
    assert sorted(place.rglob('*')) == before
