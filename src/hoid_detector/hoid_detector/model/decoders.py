"""Decoders of network outputs into candidate boxes, one for each kind of output.

All return boxes (x1, y1, x2, y2) in pixels of the network input, and only those whose score
reaches the threshold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hoid_common.values import BoolArray, Float32Array, IntArray

Size = tuple[int, int]  # (width, height) of the network input, px
Outputs = Sequence[NDArray[Any]]


class Candidates(NamedTuple):
    """Boxes before non-maximum suppression."""

    boxes_xyxy_px: Float32Array  # (N, 4), of the network input
    scores: Float32Array  # (N,)
    class_ids: IntArray  # (N,)

    def select(self, keep: BoolArray | IntArray) -> Candidates:
        """Return the candidates at a (N,) mask or at indices."""
        return Candidates(self.boxes_xyxy_px[keep], self.scores[keep], self.class_ids[keep])


class Decoder(Protocol):
    """Decodes the outputs of one run of a network."""

    def __call__(self, outputs: Outputs, size_wh: Size, score_threshold: float) -> Candidates:
        """Return the candidates whose score is at least the threshold."""


@dataclass(frozen=True)
class AnchorDecoder:
    """Decodes (cx, cy, w, h, [objectness,] class scores) of N anchors: YOLO 5 to 11, YOLOX."""

    anchors_last: bool  # the output is (C, N), else (N, C)
    objectness: bool  # the score is objectness * class score
    normalized: bool  # boxes are fractions of the input, else pixels
    cell_strides_px: tuple[int, ...] = ()  # YOLOX: boxes are relative to the cells of these grids

    def __call__(self, outputs: Outputs, size_wh: Size, score_threshold: float) -> Candidates:
        """Return the candidates whose score is at least the threshold."""
        table = _float32(outputs[0])[0]
        channels = table if self.anchors_last else table.T
        if (
            self.objectness
        ):  # class scores are at most 1, so objectness alone excludes most anchors
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
        best = _best_class(_xyxy_from_cxcywh(boxes.T), class_scores.T, score_threshold)
        return _in_pixels(best, size_wh, normalized=self.normalized)


@dataclass(frozen=True)
class TableDecoder:
    """Decodes one table of boxes after non-maximum suppression, as of YOLOv10 or YOLOv7.

    Its columns are x1, y1, x2, y2, score, class; or image, x1, y1, x2, y2, class, score.
    """

    normalized: bool  # boxes are fractions of the input, else pixels

    def __call__(self, outputs: Outputs, size_wh: Size, score_threshold: float) -> Candidates:
        """Return the candidates whose score is at least the threshold."""
        table = _float32(outputs[0])
        table = table.reshape(-1, table.shape[-1])
        if table.shape[1] == 7:
            boxes, class_ids, scores = table[:, 1:5], table[:, 5], table[:, 6]
        else:
            boxes, scores, class_ids = table[:, :4], table[:, 4], table[:, 5]
        keep = scores >= score_threshold
        found = Candidates(boxes[keep], scores[keep], class_ids[keep].astype(np.int64))
        return _in_pixels(found, size_wh, normalized=self.normalized)


@dataclass(frozen=True)
class SeparateOutputsDecoder:
    """Decodes boxes, labels and scores that are outputs of their own, given by their indices."""

    boxes: int  # (1, N, 4), x1 y1 x2 y2
    labels: int  # (1, N)
    scores: int  # (1, N)
    count: int | None  # (1, 1), the number of valid rows; None: all are valid
    normalized: bool  # boxes are fractions of the input, else pixels

    def __call__(self, outputs: Outputs, size_wh: Size, score_threshold: float) -> Candidates:
        """Return the candidates whose score is at least the threshold."""
        count = None if self.count is None else _num_valid_rows(outputs[self.count])
        found = Candidates(
            _float32(outputs[self.boxes]).reshape(-1, 4)[:count],
            _float32(outputs[self.scores]).reshape(-1)[:count],
            outputs[self.labels].reshape(-1)[:count].astype(np.int64),
        )
        keep = found.scores >= score_threshold
        return _in_pixels(found.select(keep), size_wh, normalized=self.normalized)


@dataclass(frozen=True)
class LogitsDecoder:
    """Decodes the outputs of the DETR family, given by their indices."""

    boxes: int  # (1, N, 4), cx cy w h as fractions of the input
    logits: int  # (1, N, C), of the classes

    def __call__(self, outputs: Outputs, size_wh: Size, score_threshold: float) -> Candidates:
        """Return the candidates whose score is at least the threshold."""
        # exp(80) is finite in float32, exp(90) is not.
        logits = np.clip(_float32(outputs[self.logits])[0], -80, 80)
        boxes = _xyxy_from_cxcywh(_float32(outputs[self.boxes])[0])
        best = _best_class(boxes, 1 / (1 + np.exp(-logits)), score_threshold)
        return _in_pixels(best, size_wh, normalized=True)


@lru_cache(maxsize=8)
def cells(size_wh: Size, strides_px: tuple[int, ...]) -> tuple[Float32Array, Float32Array]:
    """Return column and row (2, N) and stride in pixels (N,) of all grid cells, row by row."""
    grids = [
        np.mgrid[: size_wh[1] // s, : size_wh[0] // s][::-1].reshape(2, -1) for s in strides_px
    ]
    strides = np.repeat(strides_px, [grid.shape[1] for grid in grids])
    return np.concatenate(grids, axis=1).astype(np.float32), strides.astype(np.float32)


def _num_valid_rows(output: NDArray[Any]) -> int:
    """Return the row count in an output of one element; 0 where it is not finite."""
    number = float(output.reshape(-1)[0])
    return max(int(number), 0) if np.isfinite(number) else 0


def _from_cells(boxes: Float32Array, cell: Float32Array, stride_px: Float32Array) -> Float32Array:
    """Return (4, N) cx, cy, w, h in pixels, from center offsets and log sizes in cells.

    Ge et al., YOLOX: Exceeding YOLO Series in 2021.
    """
    return np.concatenate([boxes[:2] + cell, np.exp(boxes[2:])]) * stride_px


def _best_class(
    boxes_xyxy: Float32Array, class_scores: Float32Array, threshold: float
) -> Candidates:
    class_ids = class_scores.argmax(axis=1)
    scores = np.take_along_axis(class_scores, class_ids[:, None], axis=1)[:, 0]
    return Candidates(boxes_xyxy, scores, class_ids).select(scores >= threshold)


def _xyxy_from_cxcywh(boxes: Float32Array) -> Float32Array:
    half = boxes[:, 2:] / 2
    return np.concatenate([boxes[:, :2] - half, boxes[:, :2] + half], axis=1)


def _in_pixels(found: Candidates, size_wh: Size, *, normalized: bool) -> Candidates:
    if not normalized:
        return found
    return found._replace(boxes_xyxy_px=found.boxes_xyxy_px * np.array(size_wh * 2, np.float32))


def _float32(output: NDArray[Any]) -> Float32Array:
    return np.asarray(output, np.float32)
