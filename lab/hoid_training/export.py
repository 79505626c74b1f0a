"""Exports a trained network as ONNX with YOLOv8's output, half-precision weights and classes."""

from __future__ import annotations

import warnings
from io import BytesIO
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor, nn

from hoid_training.dataset import CLASSES, INPUT_WH
from hoid_training.network import Detector

_OPSET = 17
_SMALL = 64  # arrays of fewer elements stay in single precision


class YoloOutput(nn.Module):
    """A detector with the output (1, 4 + C, N): center x, y, width, height and class scores."""

    def __init__(self, detector: nn.Module) -> None:
        super().__init__()
        self.detector = detector

    def forward(self, image: Tensor) -> Tensor:
        """Return the output of YOLOv8's head for an image."""
        boxes, logits = self.detector(image)
        low, high = boxes[..., :2], boxes[..., 2:]
        out = torch.cat([(low + high) / 2, high - low, logits.sigmoid()], -1)
        return out.transpose(1, 2)


def write_onnx(network: nn.Module, path: Path) -> None:
    """Write a network for images of the size INPUT_WH; no partial file is left."""
    buffer = BytesIO()
    image = torch.zeros(1, 3, INPUT_WH[1], INPUT_WH[0])
    wrapped = YoloOutput(network).eval()
    with warnings.catch_warnings():
        # A warning that the input size becomes a constant, as intended.
        warnings.simplefilter('ignore')
        torch.onnx.export(
            wrapped,
            (image,),
            buffer,
            opset_version=_OPSET,
            dynamo=False,
            input_names=['images'],
            output_names=['output0'],
        )
    model = onnx.load_from_string(buffer.getvalue())
    _halve_weights(model)
    names = dict(enumerate(CLASSES))
    helper.set_model_props(model, {'names': str(names), 'task': 'detect'})
    onnx.checker.check_model(model)
    partial = path.with_suffix('.part')
    partial.write_bytes(model.SerializeToString())
    partial.replace(path)


def _halve_weights(model: onnx.ModelProto) -> None:
    """Store large arrays in half precision; runtimes convert them when they load the model."""
    casts = []
    for weight in model.graph.initializer:
        array = numpy_helper.to_array(weight)
        if array.dtype != np.float32 or array.size < _SMALL:
            continue
        name = weight.name
        weight.CopyFrom(numpy_helper.from_array(array.astype(np.float16), f'{name}.half'))
        casts.append(helper.make_node('Cast', [f'{name}.half'], [name], to=TensorProto.FLOAT))
    nodes = [*casts, *model.graph.node]
    del model.graph.node[:]
    model.graph.node.extend(nodes)


def num_parameters(network: Detector) -> int:
    """Return the number of weights of a network."""
    return sum(p.numel() for p in network.parameters())
