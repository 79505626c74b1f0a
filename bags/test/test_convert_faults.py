"""Conversions that fail: one line names the cause, and no file is left behind."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from rosbags.rosbag2.storage_mcap import McapWriter

from hoid_bags.convert import ConvertConfig, convert
from hoid_common.errors import ConfigError, InputError
from hoid_common.values import CameraModel

FolderMaker = Callable[..., Path]
MM = ConvertConfig(depth_units_per_m=1000.0)


def test_a_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='nowhere: no such folder'):
        convert(tmp_path / 'nowhere', tmp_path / 'bag')
    assert list(tmp_path.iterdir()) == []


FAULTS: dict[str, Callable[[Path], object]] = {
    'truncated image': lambda f: _truncate(sorted((f / 'rgb').iterdir())[2]),
    'depth must be 16-bit': lambda f: cv2.imwrite(
        str(sorted((f / 'depth').iterdir())[2]), np.zeros((24, 32), np.uint8)
    ),
    'lists no images': lambda f: (f / 'rgb.txt').write_text(''),
    'no such file': lambda f: (f / 'depth.txt').unlink(),
    'which does not exist': lambda f: sorted((f / 'rgb').iterdir())[2].unlink(),
    'is not a time in seconds': lambda f: (f / 'rgb.txt').write_text('soon rgb/1.png'),
    'not 3 numbers': lambda f: (f / 'accelerometer.txt').write_text('1 2 x 3\n'),
}


def _truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


@pytest.mark.parametrize('expected', list(FAULTS))
def test_a_fault_leaves_nothing(
    make_folder: FolderMaker, camera: CameraModel, tmp_path: Path, expected: str
) -> None:
    folder = make_folder(3)
    FAULTS[expected](folder)
    with pytest.raises(InputError, match=expected) as caught:
        convert(folder, tmp_path / 'bag', MM, camera)
    assert '\n' not in str(caught.value)
    assert list(tmp_path.iterdir()) == [folder]


def test_an_existing_bag_is_kept(
    make_folder: FolderMaker, camera: CameraModel, tmp_path: Path
) -> None:
    bag = tmp_path / 'bag'
    bag.mkdir()
    (bag / 'precious').write_text('data')
    with pytest.raises(InputError, match='exists already'):
        convert(make_folder(1), bag, MM, camera)
    assert (bag / 'precious').read_text() == 'data'


@pytest.mark.parametrize('method', ['write', 'close'])
def test_a_full_disk_leaves_nothing(
    make_folder: FolderMaker,
    camera: CameraModel,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    method: str,
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    folder = make_folder(2)
    monkeypatch.setattr(McapWriter, method, refuse)
    with pytest.raises(InputError, match='bag: cannot be written: No space left on device'):
        convert(folder, tmp_path / 'bag', MM, camera)
    assert list(tmp_path.iterdir()) == [folder]


def test_a_folder_that_cannot_be_written(make_folder: FolderMaker, camera: CameraModel) -> None:
    folder = make_folder(1)
    with pytest.raises(InputError, match='cannot be written'):
        convert(folder, folder / 'rgb.txt' / 'bag', MM, camera)


def test_an_interrupt_leaves_nothing(
    make_folder: FolderMaker,
    camera: CameraModel,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    folder = make_folder(2)
    monkeypatch.setattr(McapWriter, 'write', interrupt)
    with pytest.raises(KeyboardInterrupt):
        convert(folder, tmp_path / 'bag', MM, camera)
    assert list(tmp_path.iterdir()) == [folder]


def test_unknown_encoding() -> None:
    with pytest.raises(ConfigError, match='rgb must be one of'):
        ConvertConfig(rgb='gif')
