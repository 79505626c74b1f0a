"""Graphs that turn a network with the layout of YOLOv8 into the exports of other tools.

They are written in ONNX's text form. A model is an input, a network, the parts that outputs are
made of (`_PARTS`), and the outputs of a form.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from hoid_common.coco import COCO, COCO_IDS
from hoid_detector.model.decoders import Size, cells

onnx: Any = pytest.importorskip('onnx', reason='builds its models with the onnx package')

_IR_VERSION, _OPSET = 9, 20
_HEADER = f'<ir_version: {_IR_VERSION}, opset_import: ["" : {_OPSET}, "TRT" : 1]>'
_STRIDES_PX = (8, 16, 32)
# Each input: its declaration, and the nodes that make `image` of it, RGB from 0 to 1.
_INPUTS = {
    'float': ('float[1,3,H,W] images', 'image = Identity(images)'),
    'half': ('float16[1,3,H,W] images', 'image = Cast<to=1>(images)'),
    'float, channels last': (
        'float[1,H,W,3] images',
        'image = Transpose<perm=[0,3,1,2]>(images)',
    ),
    'bytes': ('uint8[1,3,H,W] images', 'of_byte = Cast<to=1>(images) image = Div(of_byte, c_255)'),
    'bytes, channels last': (
        'uint8[1,H,W,3] "input_tensor:0"',
        """of_byte = Cast<to=1>("input_tensor:0")
        planes = Transpose<perm=[0,3,1,2]>(of_byte) image = Div(planes, c_255)""",
    ),
    'BGR 0-255': (
        'float[1,3,H,W] images',
        'rgb = Gather<axis=1>(images, c_210) image = Div(rgb, c_255)',
    ),
    'ImageNet': (
        'float[1,3,H,W] pixel_values',
        'scaled = Mul(pixel_values, deviation) image = Add(scaled, mean)',
    ),
    'batch of 4': ('float[4,3,H,W] images', 'image = Slice(images, c_0, c_1)'),
    'no batch': ('float[3,H,W] images', 'image = Unsqueeze(images, c_0)'),
    'any size': ('float[batch,3,height,width] images', 'image = Identity(images)'),
}
_INPUT_CONSTANTS = """
float c_255 = {255.0}, int64[3] c_210 = {2, 1, 0}, int64[1] c_0 = {0}, int64[1] c_1 = {1},
float[1,3,1,1] deviation = {0.229, 0.224, 0.225}, float[1,3,1,1] mean = {0.485, 0.456, 0.406}
"""

# The boxes of the network `found` (1, 84, N), without and with non-maximum suppression: `all_...`
# have one row per cell, `xyxy`, `score`, ... one row per box, `query_...` 300 rows. The ending
# `_n` means fractions of the input size.
_PARTS = """
    center, sides_px, classes_first = Split<axis=1>(found, c_2_2_80)
    half = Div(sides_px, c2) low = Sub(center, half) high = Add(center, half)
    corners = Concat<axis=1>(low, high) all_xyxy = Transpose<perm=[0,2,1]>(corners)
    all_scores = Transpose<perm=[0,2,1]>(classes_first)
    boxes_first = Concat<axis=1>(center, sides_px)
    all_cxcywh = Transpose<perm=[0,2,1]>(boxes_first) all_cxcywh_n = Div(all_cxcywh, whwh)
    best = ReduceMax<keepdims=1>(all_scores, i_2) all_best = Max(best, c_least)
    all_objectness = Sqrt(all_best)
    all_conditional = Div(all_scores, all_objectness)
    all_ones = Div(all_best, all_best) all_nothing = Sub(all_ones, all_ones)
    x_y, w_h = Split<axis=2, num_outputs=2>(all_cxcywh)
    in_strides = Div(x_y, stride) offset = Sub(in_strides, cell)
    sides = Div(w_h, stride) log_sides = Log(sides)

    chosen = NonMaxSuppression(all_xyxy, classes_first, i_50, iou, least)
    batch_id, id, row_column = Split<axis=1, num_outputs=3>(chosen)
    row = Squeeze(row_column, i_1) flat_xyxy = Squeeze(all_xyxy, i_0) xyxy = Gather(flat_xyxy, row)
    score_row = GatherND(classes_first, chosen) score = Unsqueeze(score_row, i_1)
    batch = Cast<to=1>(batch_id) class = Cast<to=1>(id) class_from_1 = Add(class, c1)
    id_91 = Gather(coco_ids, id) class_91 = Cast<to=1>(id_91)
    xyxy_n = Div(xyxy, whwh)
    yxyx = Gather<axis=1>(xyxy, i_1032) yxyx_n = Gather<axis=1>(xyxy_n, i_1032)
    label = Squeeze(id, i_1) label_from_1 = Add(label, i_1) label_91 = Squeeze(id_91, i_1)
    num = Shape(score_row) missing = Sub(i_300, num)
    pad_rows = Concat<axis=0>(i_00, missing, i_0) pad_row = Concat<axis=0>(i_0, missing)

    off_or_on = OneHot(label, i_80, c_01) scores_80 = Mul(off_or_on, score)
    flat_cxcywh_n = Squeeze(all_cxcywh_n, i_0) cxcywh_n = Gather(flat_cxcywh_n, row)
    query_cxcywh_n = Pad(cxcywh_n, pad_rows, c_least) query_scores_80 = Pad(scores_80, pad_rows)
    batched_cxcywh_n = Unsqueeze(query_cxcywh_n, i_0)
    likely_80 = Clip(query_scores_80, c_least, c_most)
    no_class = Mul(score, c0) no_class_300 = Pad(no_class, pad_rows)
    unlikely_300 = Clip(no_class_300, c_least, c_most)
    likely_81 = Concat<axis=1>(likely_80, unlikely_300)
    likely_91 = Gather<axis=1>(likely_81, i_columns)
    any_class = ReduceMax<keepdims=1>(likely_80, i_1) none = Sub(c1, any_class)
    log_91 = Log(likely_91) log_none = Log(none) log_92 = Concat<axis=1>(log_91, log_none)
    softmax_92 = Unsqueeze(log_92, i_0)
    against_80 = Sub(c1, likely_80) odds_80 = Div(likely_80, against_80) log_80 = Log(odds_80)
    sigmoid_80 = Unsqueeze(log_80, i_0)
    against_81 = Sub(c1, likely_81) odds_81 = Div(likely_81, against_81) log_81 = Log(odds_81)
    sigmoid_81 = Unsqueeze(log_81, i_0) sigmoid_91 = Gather<axis=2>(sigmoid_81, i_columns)
"""
# The column of each of COCO's ids 0 to 90; 80, which has no class, for those that are not used.
_COLUMNS = [COCO_IDS.index(i) if i in COCO_IDS else len(COCO) for i in range(COCO_IDS[-1] + 1)]


class Form(NamedTuple):
    """A form in which an exporter writes a detector."""

    outputs: str  # their declarations
    nodes: str  # that make the outputs of `_PARTS`
    input: str = 'float'  # key of `_INPUTS`
    preprocessing: str = 'RGB 0-1, centered'  # that must be recognized
    metadata: Mapping[str, str] = MappingProxyType({})
    parameters: Mapping[str, Any] = MappingProxyType({})  # that the user must set
    refused: str = ''  # part of what is printed; empty: the boxes of the network are found
    extra_input: str = ''  # declaration


def build(network: Any, form: Form, path: Path) -> None:
    """Write the model of a form.

    Args:
        network: Model with an input (1, 3, H, W), RGB from 0 to 1, and an output (1, 84, N): cx,
            cy, w, h in pixels and COCO's 80 scores of the N cells.
        form: Form of the export.
        path: File to write.
    """
    network = onnx.compose.add_prefix(network, 'network/')
    (image,), (found,) = network.graph.input, network.graph.output
    height, width = (d.dim_value for d in image.type.tensor_type.shape.dim[2:])
    declared, to_image = _INPUTS[form.input]
    head = _parsed(
        f'({declared}) => (float[1,3,H,W] image)', _INPUT_CONSTANTS, to_image, (width, height)
    )
    inputs = ', '.join(filter(None, ['float[1,84,N] found', form.extra_input]))
    constants = _part_constants((width, height))
    nodes = _PARTS + form.nodes
    tail = _parsed(f'({inputs}) => ({form.outputs})', constants, nodes, (width, height))
    model = onnx.compose.merge_models(head, network, [('image', image.name)])
    model = onnx.compose.merge_models(model, tail, [(found.name, 'found')])
    names = [[value.name for value in ends] for ends in (model.graph.input, model.graph.output)]
    model = onnx.utils.Extractor(model).extract_model(*names)  # without unused nodes
    onnx.helper.set_model_props(model, dict(form.metadata))
    onnx.save(model, str(path))


def yolox_as_yolov8(path: Path) -> Any:
    """Return YOLOX with the input and the output of YOLOv8: RGB from 0 to 1, and (1, 84, N)."""
    network = onnx.version_converter.convert_version(onnx.load(str(path)), _OPSET)
    network.ir_version = _IR_VERSION
    network = onnx.compose.add_prefix(network, 'yolox/')
    (image,), (found,) = network.graph.input, network.graph.output
    height, width = (d.dim_value for d in image.type.tensor_type.shape.dim[2:])
    cell, stride_px = cells((width, height), _STRIDES_PX)
    head = _parsed(
        '(float[1,3,H,W] images) => (float[1,3,H,W] image)',
        _INPUT_CONSTANTS,
        'bgr = Gather<axis=1>(images, c_210) image = Mul(bgr, c_255)',
        (width, height),
    )
    tail = _parsed(
        '(float[1,N,85] raw) => (float[1,84,N] output0)',
        f"""float[1,N,2] cell = {_values(cell.T)}, float[1,N,1] stride = {_values(stride_px)},
        int64[4] parts = {{2, 2, 1, 80}}""",
        """offset, log_sides, objectness, conditional = Split<axis=2>(raw, parts)
        in_strides = Add(offset, cell) center = Mul(in_strides, stride)
        ratio = Exp(log_sides) sides = Mul(ratio, stride) scores = Mul(conditional, objectness)
        rows = Concat<axis=2>(center, sides, scores) output0 = Transpose<perm=[0,2,1]>(rows)""",
        (width, height),
    )
    model = onnx.compose.merge_models(head, network, [('image', image.name)])
    return onnx.compose.merge_models(model, tail, [(found.name, 'raw')])


def tiny_network(size_wh: Size, boxes: Mapping[int, Sequence[tuple[float, ...]]]) -> Any:
    """Return a network that finds known boxes in red images, and nothing in others.

    Args:
        size_wh: Width and height of its input.
        boxes: Index of a class, and its boxes: cx, cy, w, h in pixels and the score.
    """
    cell, stride_px = cells(size_wh, _STRIDES_PX)
    everywhere = np.concatenate([(cell + 0.5) * stride_px, np.tile(stride_px, (2, 1))])
    scores = np.zeros((len(COCO), len(stride_px)))
    for number, (index, (*box, score)) in enumerate((i, b) for i, bs in boxes.items() for b in bs):
        everywhere[:, 17 * number], scores[index, 17 * number] = box, score
    return _parsed(
        '(float[1,3,H,W] images) => (float[1,84,N] output0)',
        f"""float[1,4,N] boxes = {_values(everywhere)}, float[1,80,N] scores = {_values(scores)},
        float[1,3] red = {{1, 0, 0}}, float c03 = {{0.3}}, int64[2] axes = {{2, 3}},
        float weak = {{0.001}}, int64[1] i_1 = {{1}}, int64[3] i_111 = {{1, 1, 1}}""",
        """color = ReduceMean<keepdims=0>(images, axes) difference = Sub(color, red)
        distance = Abs(difference) most = ReduceMax<keepdims=0>(distance, i_1)
        is_red = Less(most, c03) gate_1 = Cast<to=1>(is_red) gate = Reshape(gate_1, i_111)
        gated = Mul(scores, gate) found = Add(gated, weak)
        output0 = Concat<axis=1>(boxes, found)""",
        size_wh,
    )


def _part_constants(size_wh: Size) -> str:
    cell, stride_px = cells(size_wh, _STRIDES_PX)
    width, height = size_wh
    return f"""
    int64[3] c_2_2_80 = {{2, 2, 80}}, float c0 = {{0.0}}, float c1 = {{1.0}}, float c2 = {{2.0}},
    int64[1] i_0 = {{0}}, int64[1] i_1 = {{1}}, int64[1] i_2 = {{2}}, int64[2] i_00 = {{0, 0}},
    int64[1] i_32 = {{32}}, int64[1] i_56 = {{56}}, int64[4] prototypes = {{1, 32, 160, 160}},
    float c_100 = {{100.0}}, int64[1] i_50 = {{50}}, int64 i_80 = {{80}}, int64[1] i_300 = {{300}},
    int64[4] i_1032 = {{1, 0, 3, 2}}, float[2] c_01 = {{0.0, 1.0}},
    float minus = {{-1.0}}, int64 i_minus = {{-1}},
    float[1] iou = {{0.45}}, float[1] least = {{0.25}},
    float c_least = {{0.0001}}, float c_most = {{0.9999}},
    float[4] whwh = {{{width}, {height}, {width}, {height}}},
    int64[80] coco_ids = {_values(np.array(COCO_IDS))},
    int64[91] i_columns = {_values(np.array(_COLUMNS))},
    float[1,N,2] cell = {_values(cell.T)}, float[1,N,1] stride = {_values(stride_px)}
    """


def _parsed(signature: str, constants: str, nodes: str, size_wh: Size = (0, 0)) -> Any:
    """Return a model; H, W and N in its declarations become the size and the number of cells."""
    width, height = size_wh
    num_cells = len(cells(size_wh, _STRIDES_PX)[1])
    for symbol, number in (('H', height), ('W', width), ('N', num_cells)):
        pattern = rf'(?<=[\[,]){symbol}(?=[\],])'
        signature, constants = (re.sub(pattern, str(number), t) for t in (signature, constants))
    return onnx.parser.parse_model(f'{_HEADER} form {signature} <{constants}> {{{nodes}}}')


def _values(array: NDArray[Any]) -> str:
    return f'{{{", ".join(map(str, array.ravel().tolist()))}}}'
