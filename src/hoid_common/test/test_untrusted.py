"""Files and names from users: within limits, or refused with one line."""

import os
from pathlib import Path

import pytest

from hoid_common.errors import ConfigError, InputError
from hoid_common.io.untrusted import check_path_name, expand_home, read_bytes, read_text


def test_a_file_is_read_up_to_its_limit(tmp_path: Path) -> None:
    path = tmp_path / 'file'
    path.write_bytes(b'\xef\xbb\xbfabc')
    assert read_bytes(path, 6) == b'\xef\xbb\xbfabc'
    assert read_text(path, 6) == 'abc'
    with pytest.raises(InputError, match='file: larger than'):
        read_bytes(path, 5)


def test_pipes_and_devices_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'pipe')
    for path in (tmp_path / 'pipe', Path('/dev/zero'), tmp_path):
        with pytest.raises(InputError, match=f'{path}: not a regular file'):
            read_bytes(path, 10)


def test_missing_and_binary_files_are_errors(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='none: no such file'):
        read_text(tmp_path / 'none')
    with pytest.raises(InputError, match='cannot be read: File name too long'):
        read_text(tmp_path / ('x' * 5000))
    (tmp_path / 'binary').write_bytes(b'\xff\xfe\xfd')
    with pytest.raises(InputError, match='binary: not a text file'):
        read_text(tmp_path / 'binary')


@pytest.mark.parametrize('text', ['a', 'x' * 255, 'é' * 127, '/'.join('x' * 255 for _ in 'abc')])
def test_names_that_files_can_have(text: str) -> None:
    check_path_name(text, '--out')


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', '--out: must not be empty'),
        ('x' * 256, 'no file can have this name'),
        ('é' * 128, 'no file can have this name'),
        ('x/' * 2500, 'no file can have this name'),
        ('a\0b', 'no file can have this name'),
        (os.fsdecode(b'caf\xe9'), r"--out 'caf\\udce9': not a UTF-8 name"),
    ],
)
def test_names_that_no_file_can_have(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        check_path_name(text, '--out')
    assert len(str(caught.value).encode()) < 200


def test_a_home_folder_that_is_not_known_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('HOME', '/home/me')
    assert expand_home('~/maps', 'map_directory') == Path('/home/me/maps')
    assert expand_home('maps/~', 'map_directory') == Path('maps/~')
    message = '^map_directory: ~nosuchuser/x: no home folder is known for ~nosuchuser; give the'
    with pytest.raises(ConfigError, match=message):
        expand_home('~nosuchuser/x', 'map_directory')
