"""Output layouts of detection networks, and recognition of the layout of a model.

`LAYOUTS` is the registry: an entry there adds a layout, also to the parameter `layout`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.coco import COCO, COCO_IDS
from hoid_common.errors import ModelError
from hoid_detector.model.decoders import (
    AnchorDecoder,
    BoxesScoresDecoder,
    Decoder,
    LogitsDecoder,
    cells,
)
from hoid_detector.model.finished_boxes import LARGEST_NORMALIZED, TABLE_LAYOUTS
from hoid_detector.model.finished_layouts import (
    has_named_columns,
    is_finished_table,
    is_stretched,
    named_columns_decoder,
    separate_outputs_decoder,
    table_decoder,
)
from hoid_detector.model.letterbox import Preprocessing
from hoid_detector.model.probe import (
    AUTO,
    Probe,
    is_boxes,
    is_class_scores,
    is_labels,
    is_logits,
    is_no_object_last,
    is_scores,
)

_COCO_CLASSES = len(COCO)
# Number of columns of logits for COCO ids 0 to 90, without and with a column for "no object"
# (DETR).
_COCO_COLUMNS = (COCO_IDS[-1] + 1, COCO_IDS[-1] + 2)
_MIN_SCORE = -0.1  # chosen: scores of quantized networks may be slightly below 0
_DETECT = 'detect'  # the only supported task, as named in Ultralytics' metadata


class Layout(NamedTuple):
    """Input format of a network and decoder of its outputs."""

    name: str
    preprocessing: Preprocessing
    decode: Decoder
    num_classes: int | None  # None if the outputs do not show it
    needs_nms: bool  # whether the boxes still need non-maximum suppression


@dataclass(frozen=True)
class LayoutEntry:
    """A known layout: how it is recognized and decoded."""

    name: str  # value of the parameter `layout`
    preprocessing: Preprocessing  # input format that published networks with this layout have
    needs_nms: bool  # whether the boxes still need non-maximum suppression
    has_one_output: bool
    matches: Callable[[Probe], bool]  # returns whether a network seems to have this layout
    # Returns the decoder for a network, and its number of classes (None if the outputs do not show
    # it).
    decoder: Callable[[Probe], tuple[Decoder, int | None]]


def recognize(probe: Probe, requested: str = AUTO) -> Layout:
    """Return the layout of a network: the first entry of `LAYOUTS` that matches.

    With a `requested` name, only entries of this name are tried, and if none matches, the first is
    used. ModelError if no entry matches, or the metadata name another task.
    """
    task = probe.metadata.get('task') or _DETECT
    if task != _DETECT:
        raise ModelError(f'is a model for the task "{task}"; export one for the task "{_DETECT}"')
    # YOLOv5 up to 6.1 also outputs its undecoded grids, which have five dimensions.
    has_one_output = all(output.ndim == 5 for output in probe.outputs[1:])
    possible = [
        entry
        for entry in LAYOUTS
        if entry.has_one_output == has_one_output and requested in (AUTO, entry.name)
    ]
    requested_first = None if requested == AUTO else next(iter(possible), None)
    entry = next((entry for entry in possible if entry.matches(probe)), requested_first)
    if entry is None:
        raise probe.unknown()
    decode, num_classes = entry.decoder(probe)
    return Layout(entry.name, entry.preprocessing, decode, num_classes, entry.needs_nms)


def _logits_decoder(probe: Probe) -> tuple[Decoder, int | None]:
    boxes, logits = probe.find(is_boxes), probe.find(is_logits)
    if boxes is None or logits is None:
        raise probe.unknown()
    num_columns = probe.outputs[logits].shape[-1]
    probe.require(probe.outputs[boxes].shape[:-1] == probe.outputs[logits].shape[:-1])
    probe.require(float(np.abs(probe.outputs[boxes]).max(initial=0)) <= LARGEST_NORMALIZED)
    probe.require(num_columns > 0)
    if num_columns in _COCO_COLUMNS and probe.num_classes in (None, _COCO_CLASSES):
        classes, has_no_object = COCO_IDS, num_columns == _COCO_COLUMNS[1]
    else:
        has_no_object = num_columns == (probe.num_classes or _COCO_CLASSES) + 1
        classes = tuple(range(num_columns - has_no_object))
    probe.require(0 < len(classes) == (probe.num_classes or len(classes)))
    # RF-DETR has a column for "no object", but no softmax.
    softmax = has_no_object and is_no_object_last(probe.outputs[logits])
    return LogitsDecoder(boxes, logits, classes, softmax), len(classes)


def _is_standardized(probe: Probe) -> bool:
    """Return whether a network with logits needs input standardized by the mean of ImageNet.

    DETR and its descendants do, except RT-DETR and D-FINE. Those have neither columns for COCO ids
    nor a logit for "no object", nor the output names of RF-DETR.
    """
    boxes, logits = probe.find(is_boxes), probe.find(is_logits)
    if boxes is None or logits is None:
        return False
    num_columns = probe.outputs[logits].shape[-1]
    with_no_object = (probe.num_classes or _COCO_CLASSES) + 1
    is_rf_detr = set(probe.names) == {'dets', 'labels'}
    return is_rf_detr or num_columns in (*_COCO_COLUMNS, with_no_object)


def _boxes_scores_decoder(probe: Probe) -> tuple[Decoder, int | None]:
    boxes, scores = probe.find(is_boxes), probe.find(is_class_scores)
    if boxes is None or scores is None:
        raise probe.unknown()
    num_classes = probe.outputs[scores].shape[-1]
    probe.require(0 < num_classes == (probe.num_classes or num_classes))
    probe.require(probe.outputs[boxes].shape[:-1] == probe.outputs[scores].shape[:-1])
    corners = probe.outputs[boxes]
    probe.require(bool((corners[..., 2:] >= corners[..., :2]).all()))
    return BoxesScoresDecoder(boxes, scores, probe.is_normalized(corners)), num_classes


def _anchor_decoder(
    probe: Probe, *, objectness: bool, in_cells: bool = False
) -> tuple[Decoder, int | None]:
    grid = probe.grid
    num_classes = len(grid.channels) - (5 if objectness else 4)
    probe.require(1 <= num_classes == (probe.num_classes or num_classes))
    probe.require(probe.table.ndim == 3 and (grid.anchors_per_cell == 1 or not in_cells))
    probe.require(not bool((grid.channels[4:] < _MIN_SCORE).any()))
    normalized = not in_cells and probe.is_normalized(grid.channels[:4])
    return AnchorDecoder(
        anchors_last=grid.anchors_last,
        objectness=objectness,
        normalized=normalized,
        corners=not in_cells and _are_corners(probe, normalized=normalized),
        cell_strides_px=grid.strides_px if in_cells else (),
    ), num_classes


def _are_corners(probe: Probe, *, normalized: bool) -> bool:
    if probe.grid.anchors_per_cell != 1:
        return False
    boxes = probe.grid.channels[:4] * (np.array(probe.size_wh * 2)[:, None] if normalized else 1)
    middle = (boxes[:2] + boxes[2:]) / 2
    return _distance_from_cells(probe, middle) < _distance_from_cells(probe, boxes[:2])


def _distance_from_cells(probe: Probe, centers_px: NDArray[Any]) -> float:
    """Return the median distance, in cells, of box centers (2, N) from the centers of their cells.

    The interpretation of an output with the least distance is right.
    """
    cell, stride_px = cells(probe.size_wh, probe.grid.strides_px)
    return float(np.median(np.abs(centers_px / stride_px - cell - 0.5)))


def _is_query_table(probe: Probe) -> bool:
    grid = probe.grid
    return not grid.strides_px and not grid.anchors_last and len(grid.channels) > 4


def _is_yolov5(probe: Probe) -> bool:
    """Return whether a table has 3 anchors per cell (YOLOv5) or an objectness of 1 (YOLOv6)."""
    grid = probe.grid
    return probe.num_before_classes == 5 and (
        grid.anchors_per_cell == 3 or bool((grid.channels[4] == 1).all())
    )


def _is_in_cells(probe: Probe) -> bool:
    """Return whether box centers are offsets in cells (YOLOX without decoder), not in pixels."""
    if probe.num_before_classes != 5:
        return False
    centers = probe.grid.channels[:2]
    return float(np.median(np.abs(centers - 0.5))) < _distance_from_cells(probe, centers)


def _has(*kinds: Callable[[str, NDArray[Any]], bool]) -> Callable[[Probe], bool]:
    return lambda probe: all(probe.find(kind) is not None for kind in kinds)


_CENTERED = Preprocessing(rgb=True, value_range='unit', placement='centered')
_STRETCHED = _CENTERED._replace(placement='stretch')
_STANDARDIZED = _STRETCHED._replace(value_range='imagenet')
_YOLOX = Preprocessing(rgb=False, value_range='byte', placement='top_left')
_is_separate = _has(is_boxes, is_labels, is_scores)
_BOX = partial(_anchor_decoder, objectness=False)
_BOX_OBJECTNESS = partial(_anchor_decoder, objectness=True)
_IN_CELLS = partial(_anchor_decoder, objectness=True, in_cells=True)

LAYOUTS = (
    # Finished boxes: their columns are outputs with names such as x1y1x2y2 (PINTO_model_zoo).
    LayoutEntry(
        'end_to_end', _CENTERED, False, False,
        has_named_columns, named_columns_decoder,
    ),
    # Finished boxes, labels and scores as separate outputs (RT-DETR, D-FINE, TensorFlow).
    LayoutEntry(
        'end_to_end', _STRETCHED, False, False,
        lambda p: _is_separate(p) and is_stretched(p), separate_outputs_decoder,
    ),
    # The same with a centered image (torchvision, EfficientNMS).
    LayoutEntry('end_to_end', _CENTERED, False, False, _is_separate, separate_outputs_decoder),
    # The same with y before x, if the names do not show it (TensorFlow).
    LayoutEntry(
        'yxyx_score_class', _STRETCHED, False, False,
        lambda _: False, partial(separate_outputs_decoder, y_first=True),
    ),
    # Logits and boxes (DETR, RF-DETR, Conditional and Deformable DETR).
    LayoutEntry('detr', _STANDARDIZED, False, False, _is_standardized, _logits_decoder),
    # The same with a stretched image (RT-DETR, D-FINE by Transformers).
    LayoutEntry('detr', _STRETCHED, False, False, _has(is_boxes, is_logits), _logits_decoder),
    # Boxes, and C class scores per cell (YOLO-NAS).
    LayoutEntry(
        'yolo_nas', _CENTERED, True, False,
        _has(is_boxes, is_class_scores), _boxes_scores_decoder,
    ),
    # One table of finished boxes, with columns in any known order, or in the requested order.
    LayoutEntry('end_to_end', _CENTERED, False, True, is_finished_table, table_decoder),
    *(
        LayoutEntry(
            name, _CENTERED, False, True, lambda _: False, partial(table_decoder, order=order)
        )
        for name, order in TABLE_LAYOUTS.items()
    ),
    # 4 + C channels per query (RT-DETR by Ultralytics).
    LayoutEntry('rtdetr', _STRETCHED, False, True, _is_query_table, _BOX),
    # 4 + C channels per cell (YOLOv8, 9, 11).
    LayoutEntry('yolov8', _CENTERED, True, True, lambda p: p.num_before_classes == 4, _BOX),
    # 5 + C channels for 3 anchors per cell (YOLOv5, 7), or for 1 (YOLOv6).
    LayoutEntry('yolov5', _CENTERED, True, True, _is_yolov5, _BOX_OBJECTNESS),
    # 5 + C channels per cell, in cell units or in pixels.
    LayoutEntry('yolox_raw', _YOLOX, True, True, _is_in_cells, _IN_CELLS),
    LayoutEntry(
        'yolox', _YOLOX, True, True, lambda p: p.num_before_classes == 5, _BOX_OBJECTNESS
    ),
)  # fmt: skip
"""Known layouts, in the order in which a model is compared with them."""
