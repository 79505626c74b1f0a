"""Decoders from network outputs to candidate boxes in pixels of the network input, and NMS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.values import BoolArray, Float32Array, IntArray

Size = tuple[int, int]  # (width, height) of the network input, px
Outputs = Sequence[NDArray[Any]]
MAX_CANDIDATES = 1000  # chosen: more boxes reach the threshold only if the threshold is near zero


class Candidates(NamedTuple):
    """N boxes with their scores and classes, before non-maximum suppression."""

    boxes_xyxy_px: Float32Array  # (N, 4), of the network input
    scores: Float32Array  # (N,)
    class_ids: IntArray  # (N,) indices of class names; negative: not a class of the model

    def select(self, keep: BoolArray | IntArray) -> Candidates:
        return Candidates(self.boxes_xyxy_px[keep], self.scores[keep], self.class_ids[keep])


class Decoder(Protocol):
    """Decodes the outputs of one run of a network."""

    def __call__(self, outputs: Outputs, size_wh: Size, score_threshold: float) -> Candidates:
        """Return the candidates whose score is at least the threshold."""


@dataclass(frozen=True)
class AnchorDecoder:
    """Decodes N anchors (YOLO 5 to 11, YOLOX), each with box, objectness and class scores."""

    anchors_last: bool  # True: the output is (C, N); False: (N, C)
    # True: a channel `objectness` follows the box, and multiplies the class scores.
    objectness: bool
    normalized: bool  # True: boxes are fractions of the input; False: pixels
    corners: bool = False  # True: boxes are x1, y1, x2, y2; False: cx, cy, w, h
    # YOLOX: boxes are relative to the cells of grids with these strides. Empty: they are absolute.
    cell_strides_px: tuple[int, ...] = ()

    def __call__(self, outputs: Outputs, size_wh: Size, score_threshold: float) -> Candidates:
        table = float32(outputs[0])[0]
        channels = table if self.anchors_last else table.T
        if self.objectness:
            # Class scores are at most 1, so that anchors with an objectness below the threshold
            # are excluded first.
            rows = np.flatnonzero(channels[4] >= score_threshold)
            class_scores = channels[5:, rows] * channels[4, rows]
        else:
            rows = np.flatnonzero(channels[4:].max(axis=0) >= score_threshold)
            class_scores = channels[4:, rows]
        boxes = channels[:4, rows]
        if self.cell_strides_px:
            boxes = _from_cells(
                boxes, *(g[..., rows] for g in cells(size_wh, self.cell_strides_px))
            )
        boxes_xyxy = boxes.T if self.corners else _xyxy_from_cxcywh(boxes.T)
        best = _best_class(boxes_xyxy, class_scores.T, score_threshold)
        return in_pixels(best, size_wh, normalized=self.normalized)


@dataclass(frozen=True)
class LogitsDecoder:
    """Decodes a network of the DETR family, whose boxes and logits are separate outputs."""

    boxes: int  # index of the output (1, N, 4): cx cy w h as fractions of the input
    logits: int  # index of the output (1, N, C): logits of the C classes
    classes: tuple[int, ...]  # columns of `logits` in the order of the class names
    softmax: bool  # True: the last column is "no object"; False: a sigmoid per class

    def __call__(self, outputs: Outputs, size_wh: Size, score_threshold: float) -> Candidates:
        # Limits for float32, in which exp(80) is finite and exp(90) is not.
        logits = np.clip(float32(outputs[self.logits])[0], -80, 80)
        if self.softmax:
            odds = np.exp(logits - logits.max(axis=1, keepdims=True))
            scores = odds / odds.sum(axis=1, keepdims=True)
        else:
            scores = 1 / (1 + np.exp(-logits))
        boxes = _xyxy_from_cxcywh(float32(outputs[self.boxes])[0])
        best = _best_class(boxes, scores[:, list(self.classes)], score_threshold)
        return in_pixels(best, size_wh, normalized=True)


@dataclass(frozen=True)
class BoxesScoresDecoder:
    """Decodes networks with one output of boxes and one of class scores (YOLO-NAS)."""

    boxes: int  # index of the output (1, N, 4): x1 y1 x2 y2
    scores: int  # index of the output (1, N, C)
    normalized: bool  # whether boxes are fractions of the network input, else pixels

    def __call__(self, outputs: Outputs, size_wh: Size, score_threshold: float) -> Candidates:
        boxes, scores = float32(outputs[self.boxes])[0], float32(outputs[self.scores])[0]
        best = _best_class(boxes, scores, score_threshold)
        return in_pixels(best, size_wh, normalized=self.normalized)


@lru_cache(maxsize=8)
def cells(size_wh: Size, strides_px: tuple[int, ...]) -> tuple[Float32Array, Float32Array]:
    """Return column and row (2, N), and stride (N,) in px, of the cells of all grids."""
    grids = [
        np.mgrid[: size_wh[1] // s, : size_wh[0] // s][::-1].reshape(2, -1) for s in strides_px
    ]
    strides = np.repeat(strides_px, [grid.shape[1] for grid in grids])
    return np.concatenate(grids, axis=1).astype(np.float32), strides.astype(np.float32)


def _from_cells(boxes: Float32Array, cell: Float32Array, stride_px: Float32Array) -> Float32Array:
    """Return boxes (4, N) cx, cy, w, h in pixels from those in cells (Ge et al., YOLOX, 2021).

    `boxes` (4, N) has the offset of each center from the corner of its cell, and the logarithms of
    width and height, all in cells.
    """
    return np.concatenate([boxes[:2] + cell, np.exp(boxes[2:])]) * stride_px


def _best_class(
    boxes_xyxy: Float32Array, class_scores: Float32Array, threshold: float
) -> Candidates:
    """Return the boxes (N, 4) whose best of C class scores (N, C) is at least the threshold."""
    class_ids = class_scores.argmax(axis=1)
    scores = np.take_along_axis(class_scores, class_ids[:, None], axis=1)[:, 0]
    return Candidates(boxes_xyxy, scores, class_ids).select(scores >= threshold)


def _xyxy_from_cxcywh(boxes: Float32Array) -> Float32Array:
    half = boxes[:, 2:] / 2
    return np.concatenate([boxes[:, :2] - half, boxes[:, :2] + half], axis=1)


def in_pixels(found: Candidates, size_wh: Size, *, normalized: bool) -> Candidates:
    if not normalized:
        return found
    return found._replace(boxes_xyxy_px=found.boxes_xyxy_px * np.array(size_wh * 2, np.float32))


def float32(output: NDArray[Any]) -> Float32Array:
    return np.asarray(output, np.float32)


def nms(
    boxes_xyxy_px: Float32Array, scores: Float32Array, class_ids: IntArray, iou: float
) -> IntArray:
    """Return the indices of the boxes (N, 4) that non-maximum suppression keeps, by score."""
    order = np.argsort(-scores, kind='stable')[:MAX_CANDIDATES]
    if len(order) < 2:
        return order
    boxes_xywh_px = boxes_xyxy_px[order]
    boxes_xywh_px[:, 2:] -= boxes_xywh_px[:, :2]
    kept = cv2.dnn.NMSBoxesBatched(
        boxes_xywh_px.tolist(), scores[order].tolist(), class_ids[order].tolist(), -1.0, iou
    )
    return order[np.sort(np.asarray(kept, np.int64).ravel())]
