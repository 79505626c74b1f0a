import subprocess
import sys
from pathlib import Path

import pytest

from hoid_common.errors import InputError
from hoid_common.io.files import check_writable, leftovers, scratch_folder, unwritable


def leave_a_result(within: Path) -> None:
    with scratch_folder(within, 'half') as folder:
        (folder / 'a').write_text('aside')
        (folder / 'a').replace(within / 'result')
        (folder / 'b').write_text('goes away')


def test_a_scratch_folder_goes_away_and_results_stay(tmp_path: Path) -> None:
    leave_a_result(tmp_path / 'new' / 'out')
    assert [p.name for p in (tmp_path / 'new' / 'out').iterdir()] == ['result']


def test_a_folder_made_for_nothing_goes_away_and_one_that_was_there_stays(tmp_path: Path) -> None:
    check_writable(tmp_path / 'out')
    assert list(tmp_path.iterdir()) == []
    check_writable(tmp_path)
    assert tmp_path.is_dir()


@pytest.mark.parametrize('name', ['file', 'file/out', 'file/deep/out'])
def test_a_file_in_the_way_is_said(tmp_path: Path, name: str) -> None:
    (tmp_path / 'file').write_text('kept')
    with pytest.raises(InputError, match=rf'{name}: cannot be written: part of this path is a'):
        check_writable(tmp_path / name)
    assert (tmp_path / 'file').read_text() == 'kept'


def test_what_the_system_says_is_passed_on() -> None:
    said = str(unwritable(Path('a b'), OSError(28, 'No space left on device')))
    assert said == 'a b: cannot be written: No space left on device'


def test_what_a_killed_process_leaves_is_told_from_what_is_in_use(tmp_path: Path) -> None:
    code = (
        'import os, signal, sys; from pathlib import Path\n'
        'from hoid_common.io.files import scratch_folder\n'
        'with scratch_folder(Path(sys.argv[1]), "bag"): os.kill(os.getpid(), signal.SIGKILL)'
    )
    subprocess.run([sys.executable, '-c', code, str(tmp_path)], check=False, timeout=60)
    with scratch_folder(tmp_path, 'used'):
        (left,) = leftovers(tmp_path)
        assert left.name.startswith('.bag.partial-')
    assert leftovers(tmp_path) == [left]
    assert leftovers(tmp_path / 'nowhere') == []
