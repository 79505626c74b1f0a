"""Inference with an ONNX model by onnxruntime."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray
from onnxruntime.capi import onnxruntime_pybind11_state as ort_errors

from hoid_common.errors import ConfigError, ModelError

_MAX_SIDE_PX = 4096  # chosen: larger inputs need seconds and gigabytes
_PROVIDERS = {  # in the order in which they are tried by default
    'tensorrt': 'TensorrtExecutionProvider',
    'cuda': 'CUDAExecutionProvider',
    'openvino': 'OpenVINOExecutionProvider',
    'cpu': 'CPUExecutionProvider',
}
_NAMES = {long: short for short, long in _PROVIDERS.items()}
_DTYPES: dict[str, type[np.number[Any]]] = {
    'tensor(uint8)': np.uint8,
    'tensor(float)': np.float32,
    'tensor(float16)': np.float16,
}
_ORT_ERRORS = (
    ort_errors.EPFail,
    ort_errors.Fail,
    ort_errors.InvalidArgument,
    ort_errors.InvalidGraph,
    ort_errors.InvalidProtobuf,
    ort_errors.NoModel,
    ort_errors.NoSuchFile,
    ort_errors.NotImplemented,
    ort_errors.RuntimeException,
    UnicodeDecodeError,  # raised for a damaged name in the model
)


class Network:
    """An ONNX model with an image input and, in some models, a second input for its size.

    The image input is (1, 3, H, W), or (1, H, W, 3) as in TensorFlow. The second input gets the
    width and height of the network input. Without `providers`, the best installed provider is
    used. ModelError if the file is not such a model; ConfigError for an unknown provider.
    """

    def __init__(self, path: Path, providers: Sequence[str], threads: int) -> None:
        self.path = path
        asked = _provider_order(providers)
        installed = ort.get_available_providers()
        usable = [name for name in asked if name in installed]
        order = list(dict.fromkeys([*usable, _PROVIDERS['cpu']]))
        with _model_errors(f'{path} is no usable ONNX model'):
            self._session = _open(path, order, threads)
            self.metadata: dict[str, str] = self._session.get_modelmeta().custom_metadata_map
            self.output_names = tuple(output.name for output in self._session.get_outputs())
            self._image, self._size_input = _inputs(path, self._session.get_inputs())
        self.takes_size = self._size_input is not None
        running = self._session.get_providers()[0]
        self.provider = _NAMES.get(running, running)
        wanted = asked[0] if providers else (usable or asked[-1:])[0]
        self.provider_warning = _provider_warning(wanted, running, installed)
        self.dtype = _DTYPES[self._image.type]
        self._has_channels_last = self._image.shape[1] != 3
        height, width = (
            self._image.shape[1:3] if self._has_channels_last else self._image.shape[2:]
        )
        fixed = isinstance(height, int) and isinstance(width, int) and min(height, width) > 0
        if fixed and max(height, width) > _MAX_SIDE_PX:
            raise ModelError(
                f'{path}: has an input of {width}x{height} px, more than {_MAX_SIDE_PX} a side'
            )
        self.size_wh: tuple[int, int] | None = (width, height) if fixed else None  # None: any size

    def run(self, blob: NDArray[np.number[Any]]) -> list[NDArray[Any]]:
        """Return the outputs for an input (1, 3, H, W); ModelError if the inference fails."""
        size = 'x'.join(map(str, blob.shape))
        with _model_errors(f'{self.path}: inference fails on input {size}'):
            image = blob.transpose(0, 2, 3, 1) if self._has_channels_last else blob
            feeds: dict[str, NDArray[Any]] = {self._image.name: np.ascontiguousarray(image)}
            if self._size_input is not None:
                size_wh = np.array([blob.shape[:1:-1]])
                kind = np.int64 if 'int64' in self._size_input.type else np.int32
                feeds[self._size_input.name] = size_wh.astype(kind)
            outputs: list[NDArray[Any]] = self._session.run(None, feeds)
        return outputs


def _provider_order(providers: Sequence[str]) -> list[str]:
    for name in providers:
        if name not in _PROVIDERS:
            known = ', '.join(_PROVIDERS)
            raise ConfigError(f'providers: "{name}" is not one of {known}')
    return [_PROVIDERS[name] for name in providers or _PROVIDERS]


def _provider_warning(wanted: str, running: str, installed: Sequence[str]) -> str:
    if wanted == running:
        return ''
    names = ', '.join(_NAMES[name] for name in installed if name in _NAMES)
    reason = 'it failed to start' if wanted in installed else f'this onnxruntime has only {names}'
    return f'the network runs on {_NAMES.get(running, running)}, not on {_NAMES[wanted]}: {reason}'


def _open(path: Path, providers: list[str], threads: int) -> ort.InferenceSession:
    if not path.is_file():
        raise ModelError(f'detector model {path} does not exist')
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    # Threads that spin while they wait for the next image would take processor time from the
    # tracker.
    options.add_session_config_entry('session.intra_op.allow_spinning', '0')
    return ort.InferenceSession(str(path), options, providers=providers)


def _inputs(path: Path, inputs: Sequence[ort.NodeArg]) -> tuple[ort.NodeArg, ort.NodeArg | None]:
    images = [i for i in inputs if _takes_one_image(i.shape) and i.type in _DTYPES]
    sizes = [
        i for i in inputs if len(i.shape) == 2 and i.type in ('tensor(int64)', 'tensor(int32)')
    ]
    if len(images) != 1 or len(images) + len(sizes) != len(inputs) or len(sizes) > 1:
        found = ', '.join(f'{i.name} {i.type} {i.shape}' for i in inputs)
        raise ModelError(
            f'{path}: has no single input (1, 3, height, width), but {found}; export it with one '
            'image as its input'
        )
    return images[0], sizes[0] if sizes else None


def _takes_one_image(shape: Sequence[int | str | None]) -> bool:
    return len(shape) == 4 and 3 in shape[1::2] and (shape[0] == 1 or type(shape[0]) is not int)


@contextmanager
def _model_errors(what: str) -> Iterator[None]:
    try:
        yield
    except _ORT_ERRORS as error:
        raise ModelError(f'{what}: {" ".join(str(error).split())[:300]}') from error
