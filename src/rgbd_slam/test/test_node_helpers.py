from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hoid_common.errors import InputError
from hoid_common.store.map_directory import (
    CLOUD,
    GRID,
    MAP,
    TRAJECTORY,
    FileKind,
    path_in,
    write_whole,
)
from rgbd_slam.tracking.image_stream import DroppedFrameCounter

MS = 1_000_000


def test_missing_images_are_counted_at_the_streams_own_rate() -> None:
    gaps = DroppedFrameCounter()
    stamps_ms = [0, 33, 67, 100, 133, 167, 200, 300, 333, 500]  # 2 missing, then 4
    for stamp_ms in stamps_ms:
        gaps.add(stamp_ms * MS)
    assert gaps.num_dropped == 6


def test_jitter_and_a_restarted_bag_are_no_gaps() -> None:
    gaps = DroppedFrameCounter()
    for start_ms in (0, 0):
        for i in range(40):
            gaps.add((start_ms + 33 * i + (-1) ** i * 5) * MS)
    assert gaps.num_dropped == 0


def missing_of(stamps_ms: list[float]) -> int:
    gaps = DroppedFrameCounter()
    for stamp_ms in stamps_ms:
        gaps.add(round(stamp_ms * MS))
    return gaps.num_dropped


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


KINDS = (MAP, TRAJECTORY, CLOUD, GRID)


def test_files_stay_in_their_folder(tmp_path: Path) -> None:
    folder = tmp_path / 'maps'
    assert path_in(str(folder), '', TRAJECTORY) == folder / 'trajectory.txt'
    assert path_in(str(folder), 'lab 2', CLOUD) == folder / 'lab 2.ply'
    assert folder.is_dir()
    for name in ('../x', '/etc/passwd', 'a/b', '..', '.', 'a\0b', 'a\nb', '.hidden', '\ud800'):
        with pytest.raises(InputError, match='no plain file name'):
            path_in(str(folder), name, MAP)


@pytest.mark.parametrize('kind', KINDS, ids=lambda kind: kind.noun)
def test_each_kind_of_file_has_its_endings(tmp_path: Path, kind: FileKind) -> None:
    folder = str(tmp_path)
    for ending in kind.endings:
        assert path_in(folder, f'room{ending}', kind).name == f'room{ending}'
    for name in ('room', '2024.05.17', 'room 2.0'):
        assert path_in(folder, name, kind).name == name + kind.endings[0]
    for ending in ('.exe', *(e for other in KINDS if other is not kind for e in other.endings)):
        with pytest.raises(InputError, match=f'{kind.noun} ends in {kind.endings[0]}'):
            path_in(folder, f'good{ending}', kind)


@given(name=st.text(max_size=300) | st.text('aä.', min_size=180, max_size=260))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_every_name_gives_a_file_that_can_be_written_or_one_line(
    tmp_path: Path, name: str
) -> None:
    for kind in KINDS:
        path = attempt(str(tmp_path), name, kind)
        if path is not None:
            assert path.parent == tmp_path
            write_whole(path, Path.touch)
            path.unlink()


def attempt(folder: str, name: str, kind: FileKind) -> Path | None:
    """Return the path of a file name; if it is refused, check that the error has one line."""
    try:
        return path_in(folder, name, kind)
    except InputError as error:
        said = str(error)
    assert '\n' not in said
    assert len(said) < 200 + len(folder)
    return None


def test_links_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / 'out.hoidmap').symlink_to(tmp_path.parent / 'elsewhere')
    with pytest.raises(InputError, match='is a link'):
        path_in(str(tmp_path), 'out', MAP)


def test_what_cannot_be_written_whole_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / 'a.txt'
    path.write_text('before')

    def fail(aside: Path) -> None:
        aside.write_text('half')
        raise OSError(28, 'No space left on device')

    with pytest.raises(InputError, match=r'a\.txt: cannot be written: No space left'):
        write_whole(path, fail)
    assert path.read_text() == 'before'
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_cannot_be_created_is_reported(tmp_path: Path) -> None:
    (tmp_path / 'file').write_text('')
    with pytest.raises(InputError, match='cannot be created'):
        path_in(str(tmp_path / 'file' / 'maps'), 'a', MAP)
