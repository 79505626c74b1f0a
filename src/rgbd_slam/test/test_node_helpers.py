from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hoid_common.errors import InputError
from hoid_common.io.param_file import load_params
from rgbd_slam.config.node_config import SlamNodeConfig
from rgbd_slam.map_io.map_directory import map_path, path_in
from rgbd_slam.tracking.stream_gaps import StreamGaps

MS = 1_000_000


def test_missing_images_are_counted_at_the_streams_own_rate() -> None:
    gaps = StreamGaps()
    stamps_ms = [0, 33, 67, 100, 133, 167, 200, 300, 333, 500]  # 2 missing, then 4
    for stamp_ms in stamps_ms:
        gaps.add(stamp_ms * MS)
    assert gaps.num_missing == 6


def test_jitter_and_a_restarted_bag_are_no_gaps() -> None:
    gaps = StreamGaps()
    for start_ms in (0, 0):
        for i in range(40):
            gaps.add((start_ms + 33 * i + (-1) ** i * 5) * MS)
    assert gaps.num_missing == 0


def missing_of(stamps_ms: list[float]) -> int:
    gaps = StreamGaps()
    for stamp_ms in stamps_ms:
        gaps.add(round(stamp_ms * MS))
    return gaps.num_missing


@pytest.mark.parametrize('slower', [1.4, 1.5, 2.0, 3.0])
def test_a_camera_that_slows_down_drops_nothing_for_long(slower: float) -> None:
    fast = [33.3 * n for n in range(60)]
    slow = [fast[-1] + slower * 33.3 * n for n in range(1, 301)]
    at_first = missing_of(fast + slow[:60])
    assert at_first <= 40
    assert missing_of(fast + slow) == at_first
    later = slow[-1] + slower * 33.3 * 4  # three are missing, at the rate of now
    assert missing_of([*fast, *slow, later]) == at_first + 3


def test_a_pause_of_the_stream_drops_nothing() -> None:
    stamps_ms = [33.3 * n for n in range(60)]
    again = [stamps_ms[-1] + 60_000 + 33.3 * n for n in range(60)]
    assert missing_of(stamps_ms + again) == 0
    assert missing_of([*stamps_ms, *again[:30], *again[32:]]) == 2


def test_images_missing_at_random_are_all_counted() -> None:
    rng = np.random.default_rng(0)
    come = [n for n in range(300) if n < 10 or n == 299 or rng.random() > 0.6]
    assert missing_of([33.3 * n for n in come]) == 300 - len(come)


def test_files_stay_in_their_folder(tmp_path: Path) -> None:
    folder = tmp_path / 'maps'
    assert path_in(str(folder), '', 'map') == folder / 'map'
    assert path_in(str(folder), 'lab 2', 'map') == folder / 'lab 2'
    assert folder.is_dir()
    for name in ('../x', '/etc/passwd', 'a/b', '..', '.', 'a\0b'):
        with pytest.raises(InputError, match='no plain file name'):
            path_in(str(folder), name, 'map')


def test_links_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / 'out').symlink_to(tmp_path.parent / 'elsewhere')
    with pytest.raises(InputError, match='is a link'):
        path_in(str(tmp_path), 'out', 'map')


def test_map_files_have_their_suffix_once(tmp_path: Path) -> None:
    for name in ('', 'map', 'map.hoidmap'):
        assert map_path(str(tmp_path), name) == tmp_path / 'map.hoidmap'
    with pytest.raises(InputError, match='no plain file name'):
        map_path(str(tmp_path), '..')


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(InputError, match='cannot be made'):
        path_in(str(tmp_path / 'file' / 'maps'), 'a', 'map')


def test_the_shipped_parameter_file_holds_the_defaults() -> None:
    path = Path(__file__).parents[1] / 'config' / 'rgbd_slam.yaml'
    values = load_params(path, 'rgbd_slam')
    assert values
    assert SlamNodeConfig().updated(values) == SlamNodeConfig()
