import subprocess
import sys
from pathlib import Path

import pytest

from hoid_common.errors import InputError
from hoid_common.io.files import (
    abandoned_scratch_folders,
    check_writable,
    scratch_folder,
    write_error,
)


def leave_a_result(within: Path) -> None:
    with scratch_folder(within, 'half') as folder:
        (folder / 'a').write_text('aside')
        (folder / 'a').replace(within / 'result')
        (folder / 'b').write_text('goes away')


def test_a_scratch_folder_is_removed_and_results_stay(tmp_path: Path) -> None:
    leave_a_result(tmp_path / 'new' / 'out')
    assert [p.name for p in (tmp_path / 'new' / 'out').iterdir()] == ['result']


@pytest.mark.parametrize('name', ['out', 'new/out', 'new/deep/out'])
def test_a_check_leaves_no_folder_that_it_made(name: str, tmp_path: Path) -> None:
    check_writable(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_check_keeps_folders_that_were_there(tmp_path: Path) -> None:
    (tmp_path / 'old').mkdir()
    check_writable(tmp_path / 'old' / 'out')
    check_writable(tmp_path / 'old')
    assert list(tmp_path.iterdir()) == [tmp_path / 'old']


@pytest.mark.parametrize('name', ['file', 'file/out', 'file/deep/out'])
def test_a_file_in_place_of_a_folder_is_an_error(tmp_path: Path, name: str) -> None:
    (tmp_path / 'file').write_text('kept')
    with pytest.raises(InputError, match=rf'{name}: cannot be written: part of this path is a'):
        check_writable(tmp_path / name)
    assert (tmp_path / 'file').read_text() == 'kept'


def test_write_error_contains_the_reason_of_the_system() -> None:
    message = str(write_error(Path('a b'), OSError(28, 'No space left on device')))
    assert message == 'a b: cannot be written: No space left on device'


def test_abandoned_scratch_folders_exclude_those_in_use(tmp_path: Path) -> None:
    code = (
        'import os, signal, sys; from pathlib import Path\n'
        'from hoid_common.io.files import scratch_folder\n'
        'with scratch_folder(Path(sys.argv[1]), "bag"): os.kill(os.getpid(), signal.SIGKILL)'
    )
    subprocess.run([sys.executable, '-c', code, str(tmp_path)], check=False, timeout=60)
    with scratch_folder(tmp_path, 'used'):
        (left,) = abandoned_scratch_folders(tmp_path)
        assert left.name.startswith('.bag.partial-')
    assert abandoned_scratch_folders(tmp_path) == [left]
    assert abandoned_scratch_folders(tmp_path / 'nowhere') == []
