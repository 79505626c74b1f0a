"""The order in which the model file is searched, and the errors when there is none."""

from __future__ import annotations

import hashlib
import io
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from hoid_common.errors import ModelError
from hoid_detector.model import model_path
from hoid_detector.model.model_path import find_model


@pytest.fixture
def shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty `../shared/models`; cache and workspace lie in a temporary folder."""
    package = tmp_path / 'workspace' / 'src' / 'hoid_detector' / 'hoid_detector'
    package.mkdir(parents=True)
    (tmp_path / 'workspace' / 'colcon.meta').touch()
    (tmp_path / 'shared' / 'models').mkdir(parents=True)
    monkeypatch.setattr(model_path, '__file__', str(package / 'model_path.py'))
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    monkeypatch.delenv('HOID_MODEL', raising=False)
    monkeypatch.setattr(urllib.request, 'urlopen', offline)
    return tmp_path / 'shared' / 'models'


def offline(*_args: Any, **_options: Any) -> None:
    raise urllib.error.URLError('no network')


def touch(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b'model')
    return path


def test_search_order(shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slower = touch(shared / 'yolov8n_int8.onnx')
    assert find_model() == slower
    cached = touch(tmp_path / 'cache' / 'hoid' / 'yolox_nano.onnx')
    assert find_model() == cached
    fast = touch(shared / 'yolox_nano.onnx')
    assert find_model() == fast
    assert find_model('') == fast
    monkeypatch.setenv('HOID_MODEL', str(cached))
    assert find_model() == cached
    assert find_model('yolov8n_int8') == slower


def test_a_model_is_found_by_name_or_path(
    shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = touch(shared / 'my_model.onnx')
    assert find_model('my_model') == own
    assert find_model('my_model.onnx') == own
    assert find_model(str(own)) == own
    synthetic = touch(tmp_path / 'workspace' / 'lab' / 'models' / 'synthetic.onnx')
    assert find_model('synthetic') == synthetic
    monkeypatch.setenv('HOID_MODEL', 'my_model')
    assert find_model() == own
    monkeypatch.chdir(tmp_path)
    assert find_model('shared/models/my_model.onnx') == Path('shared/models/my_model.onnx')


def test_the_error_names_a_model_that_does_not_exist(
    shared: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(
        ModelError, match=r'detector model gone\.onnx does not exist: give the path'
    ):
        find_model('gone.onnx')
    with pytest.raises(ModelError, match='sub/yolox_nano does not exist'):
        find_model('sub/yolox_nano')
    with pytest.raises(ModelError, match='synthetic does not exist'):
        find_model('synthetic')
    monkeypatch.setenv('HOID_MODEL', 'gone')
    with pytest.raises(ModelError, match='HOID_MODEL: gone does not exist'):
        find_model()
    assert shared.is_dir()


def test_the_error_without_network_is_one_line_and_names_a_way_out(shared: Path) -> None:
    with pytest.raises(ModelError, match='use --filter motion') as error:
        find_model()
    assert 'no network' in str(error.value)
    assert '\n' not in str(error.value)
    assert shared.is_dir()


def test_download_is_kept_only_with_the_right_sha256(
    shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(urllib.request, 'urlopen', lambda *_a, **_k: io.BytesIO(b'weights'))
    with pytest.raises(ModelError, match=r'sha256 is .* expected 695e750a'):
        find_model('yolox_nano')
    assert not (tmp_path / 'cache' / 'hoid').exists()
    digest = hashlib.sha256(b'weights').hexdigest()
    known = model_path._KNOWN['yolox_nano']._replace(sha256=digest)
    monkeypatch.setitem(model_path._KNOWN, 'yolox_nano', known)
    path = find_model()
    assert path == tmp_path / 'cache' / 'hoid' / 'yolox_nano.onnx'
    assert path.read_bytes() == b'weights'
    assert [p.name for p in path.parent.iterdir()] == ['yolox_nano.onnx']
    assert shared.is_dir()
