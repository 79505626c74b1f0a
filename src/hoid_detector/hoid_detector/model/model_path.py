"""Search for the model file of the detector.

It tries, in order, the requested model (a path or a known name), the environment variable
HOID_MODEL, `../shared/models` beside the workspace, `lab/models` in it, the user's cache, and a
download.
"""

from __future__ import annotations

import hashlib
import logging
import os
import urllib.error
import urllib.request
from pathlib import Path
from typing import NamedTuple

from hoid_common.errors import ModelError, NoModelError
from hoid_common.io.untrusted import expand_home

SYNTHETIC = 'synthetic'
"""Name of the synthetic detector, which is trained on rendered scenes; no robot installs it."""

_LOG = logging.getLogger(__name__)
_ENVIRONMENT = 'HOID_MODEL'
_TIMEOUT_S = 20.0  # chosen: limit of the connection and of each read of a download
_WORKSPACE_MARK = 'colcon.meta'  # file in the root folder of the workspace
_SYNTHETIC_FOLDER = 'lab/models'


class _KnownModel(NamedTuple):
    sha256: str
    url: str  # empty: never downloaded, because the license of the weights is not permissive


# The first model is the default (decision 025). On two cores, YOLOX-nano takes 8 ms for an image
# and YOLOv8n 50 ms.
_KNOWN = {
    'yolox_nano': _KnownModel(
        '695e750a5d5754bb5a8d5325643b59282191a7e7a564e435a415fd3c578eab14',
        'https://github.com/Megvii-BaseDetection/YOLOX/releases/download/0.1.1rc0/yolox_nano.onnx',
    ),
    'yolov8n_int8': _KnownModel(
        '83de8f0d2cd521e00ae2b138c340a03dece35b060b3898509bdc69afff417312', ''
    ),
}


def known_models() -> tuple[str, ...]:
    """Return the names of known models; `synthetic` exists in the source tree only."""
    return (SYNTHETIC, *_KNOWN)


def find_model(requested: str | None = None) -> Path:
    """Return the ONNX file of the requested model (a path or known name), or the default one.

    A missing model may be downloaded into the user's cache. NoModelError if the download fails;
    ModelError if the requested model does not exist.
    """
    if requested:
        return _named(requested, 'detector model')
    if from_environment := os.environ.get(_ENVIRONMENT):
        return _named(from_environment, f'{_ENVIRONMENT}:')
    for name in _KNOWN:
        for folder in _folders():
            if (path := folder / f'{name}.onnx').is_file():
                return path
    return _downloaded(next(iter(_KNOWN)))


def _named(name: str, origin: str) -> Path:
    path = expand_home(name, origin.rstrip(':'))
    if path.is_file():
        return path
    for folder in _folders():
        if path.name == name and (found := folder / f'{path.stem}.onnx').is_file():
            return found
    if name in _KNOWN and _KNOWN[name].url:
        return _downloaded(name)
    known = ', '.join(known_models())
    raise ModelError(
        f'{origin} {name} does not exist: give the path of an ONNX file, or one of {known}'
    )


def _folders() -> list[Path]:
    here = Path(__file__).resolve()
    root = next((f for f in here.parents if (f / _WORKSPACE_MARK).is_file()), None)
    in_workspace = (
        [] if root is None else [root.parent / 'shared' / 'models', root / _SYNTHETIC_FOLDER]
    )
    return [*in_workspace, _cache()]


def _cache() -> Path:
    base = os.environ.get('XDG_CACHE_HOME')
    return expand_home(base or '~/.cache', 'XDG_CACHE_HOME') / 'hoid'


def _downloaded(name: str) -> Path:
    model, target = _KNOWN[name], _cache() / f'{name}.onnx'
    partial = target.with_suffix(f'.{os.getpid()}.part')
    _LOG.info('downloading %s to %s', model.url, target)
    try:
        with urllib.request.urlopen(model.url, timeout=_TIMEOUT_S) as response:  # noqa: S310 https
            data = response.read()
        digest = hashlib.sha256(data).hexdigest()
        if digest != model.sha256:
            raise ModelError(f'{model.url}: sha256 is {digest}, expected {model.sha256}')
        target.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(data)
        partial.replace(target)
    except (urllib.error.URLError, OSError) as error:
        partial.unlink(missing_ok=True)
        raise NoModelError(
            f'no detector model found, and {model.url} cannot be downloaded ({error}): give '
            f'--detector MODEL.onnx, set {_ENVIRONMENT}, or use --filter motion, which needs none'
        ) from error
    return target
