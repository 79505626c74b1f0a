"""Small ONNX models with constant, known outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]
MakeModel = Callable[..., Path]


@pytest.fixture
def make_model(tmp_path: Path) -> MakeModel:
    """Return a function that writes a model with the given arrays as outputs for every image."""
    onnx = pytest.importorskip('onnx', reason='builds its models with the onnx package')

    def make(
        outputs: Arrays,
        *,
        size_wh: tuple[int | str, int | str] = (96, 64),
        dtype: str = 'float32',
        metadata: Mapping[str, str] | None = None,
        boxes_times_size: str = '',
    ) -> Path:
        """Write a model; the output `boxes_times_size` is multiplied by the input image size."""
        h = onnx.helper
        image = h.make_tensor_value_info(
            'images', h.np_dtype_to_tensor_dtype(np.dtype(dtype)), [1, 3, *size_wh[::-1]]
        )
        inputs, nodes, initializers = [image], [], []
        for name, array in outputs.items():
            initializers.append(onnx.numpy_helper.from_array(array, f'{name}_value'))
            if name != boxes_times_size:
                nodes.append(h.make_node('Identity', [f'{name}_value'], [name]))
        if boxes_times_size:
            inputs.append(
                h.make_tensor_value_info('orig_target_sizes', onnx.TensorProto.INT64, [1, 2])
            )
            nodes += [
                h.make_node('Cast', ['orig_target_sizes'], ['size'], to=onnx.TensorProto.FLOAT),
                h.make_node('Concat', ['size', 'size'], ['sizes'], axis=1),
                h.make_node('Mul', [f'{boxes_times_size}_value', 'sizes'], [boxes_times_size]),
            ]
        results = [
            h.make_tensor_value_info(name, h.np_dtype_to_tensor_dtype(a.dtype), a.shape)
            for name, a in outputs.items()
        ]
        return save(
            onnx, h.make_graph(nodes, 'known', inputs, results, initializers), metadata or {}
        )

    def save(onnx: Any, graph: Any, metadata: Mapping[str, str]) -> Path:
        model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid('', 17)])
        model.ir_version = 8
        onnx.helper.set_model_props(model, dict(metadata))
        path = tmp_path / 'model.onnx'
        onnx.save(model, path)
        return path

    make.save = save  # type: ignore[attr-defined]
    return make
