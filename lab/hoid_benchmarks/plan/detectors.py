"""Evaluation of detectors on recordings with ground-truth boxes (the paper's Table 1)."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf.empty_pb2 import Empty
from google.protobuf.unknown_fields import UnknownFieldSet

from hoid_bags.sequence import Sequence
from hoid_common.errors import InputError
from hoid_common.values import PERSON, Detections
from hoid_detector.config import DetectorConfig
from hoid_detector.model.model_path import find_model
from hoid_detector.onnx_detector import OnnxDetector
from hoid_synth.truth import box_iou

_BOXES = 'people.csv'  # in the folder of a recording into which people were pasted
_FOUND_IOU = 0.5
# Limit of COCO's "small" objects, by the shorter side; smaller boxes are not counted.
_SMALL_PX = 32
_GRAPH, _INITIALIZER, _DIMS = 7, 5, 1  # fields of ONNX's ModelProto, GraphProto and TensorProto


@dataclass
class _Count:
    """Number of ground-truth boxes, and how many of them the detector found."""

    # By whether it is a person.
    known: dict[bool, int] = field(default_factory=lambda: {True: 0, False: 0})
    found: dict[bool, int] = field(default_factory=lambda: {True: 0, False: 0})

    def recall(self, is_person: bool) -> float | None:
        return self.found[is_person] / self.known[is_person] if self.known[is_person] else None


def evaluate_detector(sequence: Sequence, path: Path, model: str) -> dict[str, Any]:
    """Return input size, number of parameters, latency and recall of a detector.

    Args:
        sequence: The recording, with ground-truth boxes or a list of pasted people.
        path: Folder of the recording.
        model: Path or name of an ONNX model.

    Raises:
        InputError: The recording has no ground-truth boxes.
        ModelError: There is no such model.
    """
    truth = _known_boxes(sequence, path)
    file = find_model(model)
    detector = OnnxDetector(file, DetectorConfig())
    count, spent_ms = _Count(), []
    for frame in sequence:
        found = detector.detect(frame.image_bgr, frame.stamp_ns)
        spent_ms.append(detector.detect_ms)
        known = truth.get(frame.stamp_ns)
        if known is not None:
            _compare(known, found, set(detector.class_names), count)
    width_px, height_px = detector.network.size_wh or (0, 0)
    return {
        'input': f'{width_px} x {height_px}' if width_px else 'any',
        'parameters': num_parameters(file.read_bytes()),
        'latency_ms': round(float(np.median(spent_ms)), 2),
        'people': count.known[True],
        'recall_person': count.recall(True),
        'objects': count.known[False],
        'recall_object': count.recall(False),
    }


def num_parameters(model: bytes) -> int:
    """Return the number of stored values of an ONNX file, including constants of the graph."""
    total = 0
    for graph in _fields(model, _GRAPH):
        for tensor in _fields(graph, _INITIALIZER):
            total += int(np.prod(_dims(tensor), dtype=np.int64))
    return total


def _compare(known: Detections, found: Detections, classes: set[str], count: _Count) -> None:
    """Count the ground-truth boxes of the model's classes, and those that were found."""
    sides_px = known.boxes_xyxy_px[:, 2:] - known.boxes_xyxy_px[:, :2]
    iou = box_iou(known.boxes_xyxy_px, found.boxes_xyxy_px)
    same = np.array(known.class_names)[:, None] == np.array(found.class_names)[None, :]
    hit = ((iou >= _FOUND_IOU) & same).any(axis=1)
    for name, side_px, is_hit in zip(known.class_names, sides_px, hit, strict=True):
        if name in classes and side_px.min() >= _SMALL_PX:
            count.known[name == PERSON] += 1
            count.found[name == PERSON] += bool(is_hit)


def _known_boxes(sequence: Sequence, path: Path) -> Mapping[int, Detections]:
    if sequence.true_detections is not None:
        return sequence.true_detections
    if not (path / _BOXES).is_file():
        raise InputError(f'{sequence.name}: has neither ground-truth boxes nor {_BOXES}')
    rows: dict[int, list[dict[str, str]]] = {}
    with (path / _BOXES).open(newline='') as file:
        for row in csv.DictReader(file):
            rows.setdefault(round(float(row['timestamp']) * 1e6) * 1000, []).append(row)
    return {stamp_ns: _pasted(stamp_ns, boxes) for stamp_ns, boxes in rows.items()}


def _pasted(stamp_ns: int, rows: list[dict[str, str]]) -> Detections:
    boxes = np.array([[float(row[k]) for k in ('x1', 'y1', 'x2', 'y2')] for row in rows])
    names = tuple(row['class'].replace('_', ' ') for row in rows)
    return Detections(stamp_ns, boxes.astype(np.float32), names, np.ones(len(rows), np.float32))


def _fields(message: bytes, number: int) -> list[bytes]:
    """Return the length-delimited fields with a number, without the schema of the message."""
    parsed = Empty.FromString(message)
    return [f.data for f in UnknownFieldSet(parsed) if f.field_number == number]


def _dims(tensor: bytes) -> list[int]:
    """Return the dimensions of a tensor, which are separate fields or packed in one."""
    dims: list[int] = []
    for found in UnknownFieldSet(Empty.FromString(tensor)):
        if found.field_number == _DIMS:
            packed = isinstance(found.data, bytes)
            dims += _varints(found.data) if packed else [int(found.data)]
    return dims


def _varints(data: bytes) -> list[int]:
    values, value, shift = [], 0, 0
    for byte in data:
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            values.append(value)
            value, shift = 0, 0
    return values
