"""Detector exports as people have them: how each exporter names and orders its outputs."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

from hoid_common.coco import COCO

from .export_graphs import Form

_STRETCHED, _IMAGENET = 'RGB 0-1, stretch', 'RGB ImageNet, stretch'
_YOLOX = 'BGR 0-255, top_left'
_UNKNOWN = 'unknown output layout: '


def _ultralytics(**more: Any) -> dict[str, str]:
    """Return the metadata that Ultralytics writes, as far as they matter here."""
    known = {'author': 'Ultralytics', 'task': 'detect', 'names': dict(enumerate(COCO))}
    return {key: str(value) for key, value in {**known, **more}.items()}


def _table(name: str, *columns: str) -> tuple[str, str]:
    """Return the declaration and the nodes of finished boxes as a (N, C) table."""
    return (
        f'float[K,{len(columns) + 3}] {name}',
        f'{name} = Concat<axis=1>({", ".join(columns)})',
    )


def _separate(labels: str) -> tuple[str, str]:
    """Return the declarations and the nodes of boxes, labels and scores."""
    return (
        'float[K,4] boxes, int64[K] labels, float[K] scores',
        f'boxes = Identity(xyxy) labels = Identity({labels}) scores = Identity(score_row)',
    )


def _padded(name: str, *columns: str) -> tuple[str, str]:
    """Return the declaration and the nodes of finished boxes as (1, 300, C), padded with zeros."""
    return (
        f'float[1,300,{len(columns) + 3}] {name}',
        f"""joined = Concat<axis=1>({', '.join(columns)}) padded = Pad(joined, pad_rows)
        {name} = Unsqueeze(padded, i_0)""",
    )


_YOLOV5 = """
    anchor = Concat<axis=2>(all_cxcywh, all_objectness, all_conditional)
    other = Concat<axis=2>(all_cxcywh, all_nothing, all_conditional)
    output = Concat<axis=1>(other, anchor, other)
"""
_TENSORFLOW = (
    'float[1,K] "detection_anchor_indices:0", float[1,K,4] "detection_boxes:0", '
    'float[1,K] "detection_classes:0", float[1,K,80] "detection_multiclass_scores:0", '
    'float[1,K] "detection_scores:0", float[1] "num_detections:0", '
    'float[1,N,4] "raw_detection_boxes:0", float[1,N,80] "raw_detection_scores:0"'
)
_TENSORFLOW_NODES = """
    scores = Unsqueeze(score_row, i_0) "detection_scores:0" = Identity(scores)
    "detection_anchor_indices:0" = Mul(scores, c2)
    "detection_boxes:0" = Unsqueeze(yxyx_n, i_0) classes = Squeeze(class_91, i_1)
    "detection_classes:0" = Unsqueeze(classes, i_0)
    "detection_multiclass_scores:0" = Unsqueeze(scores_80, i_0)
    "num_detections:0" = Cast<to=1>(num)
    corners_last = Gather<axis=2>(all_xyxy, i_1032)
    "raw_detection_boxes:0" = Div(corners_last, whwh)
    "raw_detection_scores:0" = Identity(all_scores)
"""

FORMS: dict[str, Form] = {
    'Ultralytics YOLOv8, 9, 11, 12': Form(
        'float[1,84,N] output0', 'output0 = Identity(found)',
        metadata=_ultralytics(end2end=False),
    ),
    'YOLOv8, cells first': Form(
        'float[1,N,84] output0', 'output0 = Transpose<perm=[0,2,1]>(found)',
    ),
    'YOLOv8, normalized boxes': Form(
        'float[1,N,84] output0', 'output0 = Concat<axis=2>(all_cxcywh_n, all_scores)',
    ),
    'YOLOv8, half precision': Form(
        'float16[1,84,N] output0', 'output0 = Cast<to=10>(found)', input='half',
        metadata=_ultralytics(),
    ),
    'YOLOv8, corners instead of centers': Form(
        'float[1,N,84] output0', 'output0 = Concat<axis=2>(all_xyxy, all_scores)',
    ),
    'YOLOv5, YOLOv7 with grid': Form('float[1,M,85] output', _YOLOV5),
    'YOLOv5 up to 6.1': Form(
        'float[1,M,85] output, float[1,3,H,W,85] onnx_1, float[1,3,H,W,85] onnx_2',
        _YOLOV5 + ' two = Unsqueeze(anchor, i_1) three = Unsqueeze(two, i_1) '
        'onnx_1 = Concat<axis=1>(three, three, three) onnx_2 = Identity(onnx_1)',
    ),
    'YOLOv6': Form(
        'float[1,N,85] outputs',
        'outputs = Concat<axis=2>(all_cxcywh, all_ones, all_scores)',
    ),
    'YOLOX': Form(
        'float[1,N,85] output',
        'output = Concat<axis=2>(offset, log_sides, all_objectness, all_conditional)',
        input='BGR 0-255', preprocessing=_YOLOX,
    ),
    'YOLOX with decoded boxes': Form(
        'float[1,N,85] output',
        'output = Concat<axis=2>(all_cxcywh, all_objectness, all_conditional)',
        input='BGR 0-255', preprocessing=_YOLOX,
    ),
    'YOLO-NAS without NMS': Form(
        'float[1,N,4] output0, float[1,N,80] output1',
        'output0 = Identity(all_xyxy) output1 = Identity(all_scores)',
    ),
    'RT-DETR (Ultralytics)': Form(
        'float[1,300,84] output0',
        'queries = Concat<axis=1>(query_cxcywh_n, query_scores_80) '
        'output0 = Unsqueeze(queries, i_0)',
        preprocessing=_STRETCHED, metadata=_ultralytics(),
    ),
    'RT-DETR, D-FINE (Transformers)': Form(
        'float[1,300,80] logits, float[1,300,4] pred_boxes',
        'logits = Identity(sigmoid_80) pred_boxes = Identity(batched_cxcywh_n)',
        preprocessing=_STRETCHED,
    ),
    'DETR (Transformers)': Form(
        'float[1,300,92] logits, float[1,300,4] pred_boxes',
        'logits = Identity(softmax_92) pred_boxes = Identity(batched_cxcywh_n)',
        input='ImageNet', preprocessing=_IMAGENET,
    ),
    'RF-DETR, Conditional and Deformable DETR': Form(
        'float[1,300,4] dets, float[1,300,91] labels',
        'labels = Identity(sigmoid_91) dets = Identity(batched_cxcywh_n)',
        input='ImageNet', preprocessing=_IMAGENET,
    ),
    'RF-DETR trained by a user': Form(
        'float[1,300,4] dets, float[1,300,81] labels',
        'labels = Identity(sigmoid_81) dets = Identity(batched_cxcywh_n)',
        input='ImageNet', preprocessing=_IMAGENET,
    ),
    'RF-DETR trained by a user, without "no object"': Form(
        'float[1,300,4] dets, float[1,300,80] labels',
        'labels = Identity(sigmoid_80) dets = Identity(batched_cxcywh_n)',
        input='ImageNet', preprocessing=_IMAGENET,
    ),
    'RT-DETR, D-FINE (their authors)': Form(
        'int64[1,K] labels, float[1,K,4] boxes, float[1,K] scores',
        'labels = Unsqueeze(label, i_0) scores = Unsqueeze(score_row, i_0) '
        'twice = Concat<axis=1>(orig_target_sizes, orig_target_sizes) '
        'size = Cast<to=1>(twice) pixels = Mul(xyxy_n, size) boxes = Unsqueeze(pixels, i_0)',
        preprocessing=_STRETCHED, extra_input='int64[1,2] orig_target_sizes',
    ),
    'Ultralytics with `nms=True`': Form(
        *_padded('output0', 'xyxy', 'score', 'class'), metadata=_ultralytics(),
    ),
    'YOLOv10, YOLO26': Form(
        *_padded('output0', 'xyxy', 'score', 'class'),
        metadata=_ultralytics(end2end=True),
    ),
    'YOLOv10, YOLO26 without metadata': Form(
        *_padded('output0', 'xyxy', 'score', 'class'),
    ),
    'YOLOv7 `--end2end --max-wh`': Form(
        *_table('output', 'batch', 'xyxy', 'class', 'score'),
    ),
    'YOLOv6, v7, v9 with EfficientNMS': Form(
        'int32[1,1] num_dets, float[1,300,4] det_boxes, float[1,300] det_scores, '
        'int32[1,300] det_classes',
        'count = Unsqueeze(num, i_0) num_dets = Cast<to=6>(count) '
        'b = Pad(xyxy, pad_rows) det_boxes = Unsqueeze(b, i_0) '
        's = Pad(score_row, pad_row) det_scores = Unsqueeze(s, i_0) '
        'l = Pad(label, pad_row) ll = Unsqueeze(l, i_0) det_classes = Cast<to=6>(ll)',
    ),
    'YOLO-NAS, batch format': Form(
        'int64[1,1] graph2_num_predictions, float[1,300,4] graph2_pred_boxes, '
        'float[1,300] graph2_pred_scores, int64[1,300] graph2_pred_classes',
        'graph2_num_predictions = Unsqueeze(num, i_0) '
        'b = Pad(xyxy, pad_rows, minus) graph2_pred_boxes = Unsqueeze(b, i_0) '
        's = Pad(score_row, pad_row, minus) graph2_pred_scores = Unsqueeze(s, i_0) '
        'l = Pad(label, pad_row, i_minus) graph2_pred_classes = Unsqueeze(l, i_0)',
        input='bytes',
    ),
    'YOLO-NAS, flat format': Form(
        *_table('graph2_flat_predictions', 'batch', 'xyxy', 'score', 'class'),
        input='bytes',
    ),
    'PINTO, 7 columns, score third': Form(
        *_table('batchno_classid_score_x1y1x2y2', 'batch', 'class', 'score', 'xyxy'),
    ),
    'PINTO, 7 columns, score last': Form(
        *_table('batchno_classid_x1y1x2y2_score', 'batch', 'class', 'xyxy', 'score'),
    ),
    'PINTO, y before x': Form(
        *_table('batchno_classid_score_y1x1y2x2', 'batch', 'class', 'score', 'yxyx'),
    ),
    'PINTO, boxes and scores apart': Form(
        'float[K,1] score, int64[K,6] batchno_classid_x1y1x2y2',
        'joined = Concat<axis=1>(batch, class, xyxy) rounded = Round(joined) '
        'batchno_classid_x1y1x2y2 = Cast<to=7>(rounded)',
    ),
    'PINTO, boxes and scores apart, y before x': Form(
        'float[K,1] score, int64[K,6] batchno_classid_y1x1y2x2',
        'joined = Concat<axis=1>(batch, class, yxyx) rounded = Round(joined) '
        'batchno_classid_y1x1y2x2 = Cast<to=7>(rounded)',
    ),
    'class, score, box, not stated': Form(
        *_table('output', 'class', 'score', 'xyxy'),
    ),
    'box, class, score, not stated': Form(
        *_table('output', 'xyxy', 'class', 'score'),
    ),
    'class, box, score, not stated, normalized': Form(
        *_table('output', 'class', 'xyxy_n', 'score'),
    ),
    'batch, class, box, score, not stated': Form(
        *_table('output', 'batch', 'class', 'xyxy', 'score'),
    ),
    'torchvision (ids of COCO)': Form(*_separate('label_91')),
    'labels 1 to 80': Form(
        *_separate('label_from_1'), parameters={'class_ids': 'from_1'},
    ),
    'labels from 0': Form(*_separate('label')),
    'labels from 0, batched, normalized boxes': Form(
        'float[1,K,4] bboxes, int64[1,K] labels, float[1,K] scores',
        'bboxes = Unsqueeze(xyxy_n, i_0) labels = Unsqueeze(label, i_0) '
        'scores = Unsqueeze(score_row, i_0)', preprocessing=_STRETCHED,
    ),
    'boxes, labels, scores, y before x, not stated': Form(
        'float[1,K,4] boxes, float[1,K] classes, float[1,K] scores',
        'boxes = Unsqueeze(yxyx_n, i_0) scores = Unsqueeze(score_row, i_0) '
        'ids = Squeeze(class_91, i_1) classes = Unsqueeze(ids, i_0)',
        preprocessing=_STRETCHED,
        parameters={'layout': 'yxyx_score_class', 'class_ids': 'coco_91'},
    ),
    'table, y before x, not stated': Form(
        *_table('detections', 'batch', 'yxyx', 'score', 'class_91'),
        parameters={'layout': 'batch_yxyx_score_class', 'class_ids': 'coco_91'},
    ),
    'TensorFlow object detection': Form(
        _TENSORFLOW, _TENSORFLOW_NODES, input='bytes, channels last',
        preprocessing=_STRETCHED,
    ),
    'finished boxes, any input size': Form(
        *_padded('output0', 'xyxy', 'score', 'class'), input='any size',
    ),
    'finished boxes, channels last': Form(
        *_padded('output0', 'xyxy', 'score', 'class'), input='float, channels last',
    ),
}  # fmt: skip
"""The exports that are recognized. Their boxes must equal those of the network itself."""

_MASKS = (
    'float[1,116,N] output0, float[1,32,160,160] output1',
    """masks = Slice(classes_first, i_0, i_32, i_1)
    output0 = Concat<axis=1>(found, masks) output1 = ConstantOfShape(prototypes)""",
)
_NO_INPUT = 'has no single input (1, 3, height, width), but '
REFUSED: dict[str, Form] = {
    'YOLOv7 without grid': Form(
        'float[1,3,N,85] output',
        'anchor = Concat<axis=2>(all_cxcywh, all_ones, all_scores) '
        'a = Unsqueeze(anchor, i_1) output = Concat<axis=1>(a, a, a)', refused=_UNKNOWN,
    ),
    'YOLOv3 of the ONNX model zoo': Form(
        'float[1,N,4] boxes, float[1,80,N] scores, int64[K,3] indices',
        'boxes = Identity(all_xyxy) scores = Identity(classes_first) indices = Identity(chosen)',
        refused=_UNKNOWN,
    ),
    'MMDeploy': Form(
        'float[1,K,5] dets, int64[1,K] labels',
        'joined = Concat<axis=1>(xyxy, score) dets = Unsqueeze(joined, i_0) '
        'labels = Unsqueeze(label, i_0)', refused=_UNKNOWN,
    ),
    'PaddleDetection': Form(
        *_table('multiclass_nms3_0', 'class', 'score', 'xyxy'),
        extra_input='float[1,2] im_shape, float[1,2] scale_factor', refused=_NO_INPUT,
    ),
    'DETR (Transformers) with a mask': Form(
        'float[1,300,92] logits, float[1,300,4] pred_boxes',
        'logits = Identity(softmax_92) pred_boxes = Identity(batched_cxcywh_n)',
        extra_input='int64[1,64,64] pixel_mask', refused=_NO_INPUT,
    ),
    'Faster R-CNN of the ONNX model zoo (no batch)': Form(
        *_separate('label_from_1'), input='no batch', refused=_NO_INPUT,
    ),
    'a batch of several images': Form(
        'float[1,84,N] output0', 'output0 = Identity(found)', input='batch of 4',
        refused=_NO_INPUT,
    ),
    'EfficientNMS of TensorRT': Form(
        'float[1,300,4] det_boxes', 'det_boxes = TRT.EfficientNMS_TRT(found)',
        refused='is no usable ONNX model',
    ),
    'segmentation': Form(
        *_MASKS, metadata=_ultralytics(task='segment'),
        refused='is a model for the task "segment"',
    ),
    'segmentation, without metadata': Form(*_MASKS, refused=_UNKNOWN),
    'pose, without metadata': Form(
        'float[1,56,N] output0', 'output0 = Slice(found, i_0, i_56, i_1)',
        refused='has 52 classes and does not name them: set class_names_file',
    ),
    'oriented boxes after NMS, without metadata': Form(
        *_table('output0', 'cxcywh_n', 'score', 'class', 'score'),
        refused='fits no known order of columns: the first row is ',
    ),
    'classification': Form(
        'float[1,80] output0', 'output0 = ReduceMax<keepdims=0>(all_scores, i_1)',
        refused=_UNKNOWN,
    ),
    'logits instead of scores': Form(
        'float[1,N,84] output0',
        'logits = Log(all_scores) output0 = Concat<axis=2>(all_cxcywh, logits)',
        refused=_UNKNOWN,
    ),
    'scores in percent': Form(
        'float[K,6] output0', 'percent = Mul(score, c_100) '
        'output0 = Concat<axis=1>(xyxy, percent, class)', refused='fits no known order of columns',
    ),
    'no person among the names': Form(
        'float[1,84,N] output0', 'output0 = Identity(found)',
        metadata=_ultralytics(names={i: f'thing {i}' for i in range(80)}),
        refused='no class is called person or ',
    ),
    'fewer names than classes': Form(
        'float[1,84,N] output0', 'output0 = Identity(found)',
        metadata=_ultralytics(names={0: 'person', 1: 'cup'}), refused='and 2 class names',
    ),
}  # fmt: skip
"""Exports that are refused, each with a line."""


NAMES: dict[str, tuple[str, str]] = {
    'a Python dict': ('names', str(dict(enumerate(COCO)))),
    'a JSON object': ('names', json.dumps(dict(enumerate(COCO)))),
    'names with their ids': ('label2id', json.dumps({name: i for i, name in enumerate(COCO)})),
    'a list': ('classes', json.dumps(COCO)),
    'YAML': ('names', '\n'.join(f'{i}: {name}' for i, name in enumerate(COCO))),
    'lines': ('labels', '\n'.join(COCO)),
    'separated by commas': ('class_names', ', '.join(COCO)),
    'none: the 80 classes of COCO': ('', ''),
}
"""Forms of class names in the metadata of a model: the key and the value."""


def page() -> str:
    """Return the lists of all exports as Markdown."""
    found = [
        f'- {name}: {"; ".join((_outputs(form), *_input(form), *_parameters(form)))}'
        for name, form in FORMS.items()
    ]
    lines = dict.fromkeys(form.refused.strip() for form in REFUSED.values())
    refused = [f'- {"; ".join(_refused_by(line))}: `{line}`' for line in lines]
    names = [f'{form} (`{key}`)' if key else form for form, (key, _) in NAMES.items()]
    return '\n'.join(
        [
            '## Recognized',
            '',
            *found,
            '',
            '## Refused',
            '',
            *refused,
            '',
            '## Class names in the metadata',
            '',
            f'Read with their keys: {"; ".join(names)}.',
        ]
    )


def _refused_by(line: str) -> list[str]:
    return [name for name, form in REFUSED.items() if form.refused.strip() == line]


def _outputs(form: Form) -> str:
    found = re.findall(r'(\w+)\[([\w,]+)\] "?([\w:]+)', form.outputs)
    return ', '.join(f'`{name}` {shape.replace(",", "x")}' for _, shape, name in found)


def _input(form: Form) -> Iterator[str]:
    """Yield what differs from the usual preprocessing and type of the input."""
    if form.preprocessing != Form('', '').preprocessing:
        yield form.preprocessing
    if form.input not in ('float', 'BGR 0-255', 'ImageNet'):
        yield form.input


def _parameters(form: Form) -> Iterator[str]:
    """Yield the parameters that the user must set."""
    for name, value in form.parameters.items():
        yield f'`{name}: {value}`'
