"""Output layouts of detection networks, and recognition of the layout that a model has.

| layout | output | input |
|---|---|---|
| `yolov8` | 4 + C channels for each grid cell (YOLOv8, 9, 11) | RGB 0-1, centered |
| `yolov5` | 5 + C channels for 3 anchors a cell (YOLOv5, 7), or 1 (YOLOv6) | RGB 0-1, centered |
| `yolox_raw`, `yolox` | 5 + C channels a cell, in cell units or pixels | BGR 0-255, top left |
| `rtdetr` | 4 + C channels a query (RT-DETR by Ultralytics) | RGB 0-1, stretched |
| `end_to_end` | N x 6, N x 7: finished boxes, columns in any known order | RGB 0-1, centered |
| `xyxy_score_class`, ... | the same, columns in the named order | RGB 0-1, centered |
| `end_to_end` | boxes, labels, scores (torchvision, EfficientNMS) | RGB 0-1, centered |
| `end_to_end` | boxes, labels, scores (RT-DETR, D-FINE, TensorFlow) | RGB 0-1, stretched |
| `detr` | logits, boxes (DETR, RT-DETR, D-FINE by Transformers, RF-DETR) | RGB 0-1, stretched |
| `yolo_nas` | boxes, C class scores a cell (YOLO-NAS) | RGB 0-1, centered |

`LAYOUTS` is the registry: one entry there adds a layout, also to the parameter `layout`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.coco import COCO, COCO_IDS
from hoid_common.errors import ModelError
from hoid_common.values import Float32Array
from hoid_detector.model.class_names import names_in_metadata
from hoid_detector.model.decoders import (
    AnchorDecoder,
    BoxesScoresDecoder,
    Decoder,
    LogitsDecoder,
    Outputs,
    cells,
    float32,
)
from hoid_detector.model.finished_boxes import (
    COCO_91,
    FROM_0,
    FROM_1,
    LARGEST_NORMALIZED,
    TABLE_LAYOUTS,
    ClassIds,
    FinishedDecoder,
    Order,
    class_ids,
    known_orders,
    order_in_name,
)
from hoid_detector.model.probe import AUTO, Probe

_COCO_CLASSES = len(COCO)
_DETECT = 'detect'  # the only task that is supported, in the metadata of Ultralytics
_PROBE_THRESHOLD = 0.25  # of scores for the test image, as in YOLOv5's detect.py


class Preprocessing(NamedTuple):
    """Input format of a network: color order, range of values, and placement of the image."""

    rgb: bool  # True: RGB; False: BGR
    unit_range: bool  # True: values from 0 to 1; False: from 0 to 255
    placement: str  # placement of the image in the input: 'centered', 'top_left' or 'stretch'

    def __str__(self) -> str:
        order = 'RGB' if self.rgb else 'BGR'
        return f'{order} {"0-1" if self.unit_range else "0-255"}, {self.placement}'


class Layout(NamedTuple):
    """Input format of a network and decoder of its outputs."""

    name: str
    preprocessing: Preprocessing
    decode: Decoder
    num_classes: int | None  # None if the outputs do not show the number
    needs_nms: bool  # whether non-maximum suppression must follow


@dataclass(frozen=True)
class LayoutEntry:
    """A known layout: how it is recognized and decoded."""

    name: str  # value of the parameter `layout`
    preprocessing: Preprocessing  # input format of the published networks with this layout
    needs_nms: bool  # whether non-maximum suppression must follow
    has_one_output: bool
    matches: Callable[[Probe], bool]  # returns whether a network seems to have this layout
    # Returns the decoder for a network, and its number of classes (None if the outputs do not
    # show the number).
    decoder: Callable[[Probe], tuple[Decoder, int | None]]


def recognize(probe: Probe, requested: str = AUTO) -> Layout:
    """Return the layout of a network.

    Args:
        probe: Outputs of the network for a test image.
        requested: Name of a layout, or AUTO for the first entry of `LAYOUTS` that matches.

    Raises:
        ModelError: The outputs have no known layout, or not the requested one.
    """
    task = probe.metadata.get('task') or _DETECT
    if task != _DETECT:
        raise ModelError(f'is a model for the task "{task}"; export one for the task "{_DETECT}"')
    for entry in LAYOUTS:
        if entry.has_one_output != (len(probe.outputs) == 1):
            continue
        if requested == entry.name or (requested == AUTO and entry.matches(probe)):
            decode, num_classes = entry.decoder(probe)
            return Layout(entry.name, entry.preprocessing, decode, num_classes, entry.needs_nms)
    raise probe.unknown()


def _logits_decoder(probe: Probe) -> tuple[Decoder, int | None]:
    boxes, logits = probe.find(_is_boxes), probe.find(_is_logits)
    if boxes is None or logits is None:
        raise probe.unknown()
    num_columns = probe.outputs[logits].shape[-1]
    probe.require(probe.outputs[boxes].shape[:-1] == probe.outputs[logits].shape[:-1])
    probe.require(float(np.abs(probe.outputs[boxes]).max(initial=0)) <= LARGEST_NORMALIZED)
    num_classes, is_coco = probe.num_classes, probe.num_classes in (None, _COCO_CLASSES)
    last_id = COCO_IDS[-1]
    if is_coco and num_columns in (last_id + 1, last_id + 2):  # with the ids of COCO; DETR: 92
        return LogitsDecoder(boxes, logits, COCO_IDS, num_columns == last_id + 2), _COCO_CLASSES
    has_no_object = num_columns == (num_classes or _COCO_CLASSES) + 1
    num_found = num_columns - has_no_object
    probe.require(0 < num_found == (num_classes or num_found))
    return LogitsDecoder(boxes, logits, tuple(range(num_found)), has_no_object), num_found


def _boxes_scores_decoder(probe: Probe) -> tuple[Decoder, int | None]:
    boxes, scores = probe.find(_is_boxes), probe.find(_is_class_scores)
    if boxes is None or scores is None:
        raise probe.unknown()
    num_classes = probe.outputs[scores].shape[-1]
    probe.require(0 < num_classes == (probe.num_classes or num_classes))
    probe.require(probe.outputs[boxes].shape[:-1] == probe.outputs[scores].shape[:-1])
    corners = probe.outputs[boxes]
    probe.require(bool((corners[..., 2:] >= corners[..., :2]).all()))
    return BoxesScoresDecoder(boxes, scores, probe.is_normalized(corners)), num_classes


def _separate_outputs_decoder(probe: Probe) -> tuple[Decoder, int | None]:
    boxes, labels = probe.find(_is_boxes), probe.find(_is_labels)
    scores = probe.find(_is_scores, 'score')
    if boxes is None or labels is None or scores is None:
        raise probe.unknown()
    num_rows = probe.outputs[boxes].size // 4
    probe.require(probe.outputs[labels].size == num_rows == probe.outputs[scores].size)
    count = probe.find(_is_count)

    def table_of(outputs: Outputs) -> Float32Array:
        parts = [float32(outputs[boxes]).reshape(-1, 4)]
        parts += [float32(outputs[i]).reshape(-1, 1) for i in (scores, labels)]
        return np.hstack(parts)[: None if count is None else _num_valid_rows(outputs[count])]

    order: Order = ('yxyx' if _is_tensorflow(probe) else 'xyxy', 'score', 'class')
    return _finished(probe, table_of, (order,)), None


def _num_valid_rows(output: NDArray[Any]) -> int:
    """Return the number of valid rows that an output of one element states; 0 if not finite."""
    number = float(output.reshape(-1)[0])
    return max(int(number), 0) if np.isfinite(number) else 0


def _table_decoder(probe: Probe, order: Order | None = None) -> tuple[Decoder, int | None]:
    num_columns = probe.table.shape[-1]
    stated = order or order_in_name(probe.names[0], num_columns)
    if stated is None and probe.metadata.get('author') == 'Ultralytics':
        stated = TABLE_LAYOUTS['xyxy_score_class']
    orders = [o for o in known_orders(num_columns) if stated in (None, o)]
    orders = orders or [stated for _ in (0,) if stated and len(stated) + 3 == num_columns]
    probe.require(bool(orders))
    return _finished(probe, lambda o: float32(o[0]).reshape(-1, num_columns), orders), None


def _finished(
    probe: Probe, table_of: Callable[[Outputs], Float32Array], orders: Sequence[Order]
) -> FinishedDecoder:
    """Return the decoder of finished boxes, which has learned from the test image."""
    normalized = None if probe.box_units == AUTO else probe.box_units == 'normalized'
    decoder = FinishedDecoder(table_of, orders, _conventions(probe), normalized)
    decoder.learn(decoder.rows(probe.outputs), _PROBE_THRESHOLD)
    decoder.has_answered = False
    return decoder


def _conventions(probe: Probe) -> list[ClassIds]:
    """Return the conventions that class ids may have, the most probable one first.

    Where nothing states the convention, 0 comes last: if the ids count from 0, the first person
    shows it. If they count from 1, nothing would show it, and a person would be a bicycle.
    """
    num_classes = probe.num_classes or _COCO_CLASSES
    if probe.class_ids != AUTO:
        return [class_ids(probe.class_ids, num_classes)]
    is_stated = names_in_metadata(probe.metadata) is not None or probe.takes_size
    counts_from_0 = len(probe.outputs) == 1 or (is_stated and not _is_tensorflow(probe))
    names = [COCO_91] * (num_classes == _COCO_CLASSES) + [FROM_1]
    names = [FROM_0, *names] if counts_from_0 else [*names, FROM_0]
    if num_classes > COCO_IDS[-1]:  # the names are those of the ids, with their gaps
        names = [FROM_0]
    return [class_ids(name, num_classes) for name in names]


def _is_tensorflow(probe: Probe) -> bool:
    """Return whether the outputs have the names of TensorFlow's models: y before x, ids from 1."""
    return probe.find(lambda name, _: name.startswith('detection_boxes')) is not None


def _is_stretched(probe: Probe) -> bool:
    """Return whether boxes, labels and scores are those of networks that stretch the image."""
    labels = probe.find(_is_labels)
    is_batched = labels is not None and probe.outputs[labels].ndim > 1
    return _is_tensorflow(probe) or (is_batched and probe.find(_is_count) is None)


def _anchor_decoder(
    probe: Probe, *, objectness: bool, in_cells: bool = False
) -> tuple[Decoder, int | None]:
    grid = probe.grid
    num_classes = len(grid.channels) - (5 if objectness else 4)
    probe.require(1 <= num_classes == (probe.num_classes or num_classes))
    probe.require(probe.table.ndim == 3 and (grid.anchors_per_cell == 1 or not in_cells))
    return AnchorDecoder(
        anchors_last=grid.anchors_last,
        objectness=objectness,
        normalized=not in_cells and probe.is_normalized(grid.channels[:4]),
        cell_strides_px=grid.strides_px if in_cells else (),
    ), num_classes


def _is_finished_table(probe: Probe) -> bool:
    """Return whether the output is a table of boxes after non-maximum suppression."""
    strides_px, num_columns = probe.grid.strides_px, probe.outputs[0].shape[-1]
    if strides_px and probe.metadata.get('end2end') != 'True':
        return False
    if order_in_name(probe.names[0], num_columns):
        return True
    if not known_orders(num_columns):
        return False
    # A table of queries with 2 or 3 classes has as many columns.
    if not (num_columns - 4 == probe.num_classes and probe.table.ndim == 3):
        return True
    try:
        _table_decoder(probe)
    except ModelError:
        return False
    return True


def _is_query_table(probe: Probe) -> bool:
    grid = probe.grid
    return not grid.strides_px and not grid.anchors_last and len(grid.channels) > 4


def _is_yolov5(probe: Probe) -> bool:
    """Return whether a table with objectness has 3 anchors per cell (YOLOv5) or is of YOLOv6.

    In YOLOv6, the objectness of every anchor is 1.
    """
    grid = probe.grid
    return probe.num_before_classes == 5 and (
        grid.anchors_per_cell == 3 or bool((grid.channels[4] == 1).all())
    )


def _is_in_cells(probe: Probe) -> bool:
    """Return whether the box centers are offsets in cells (YOLOX without decoder) and not pixels.

    Both interpretations are tried; the one that puts centers nearer to their cells is right.
    """
    if probe.num_before_classes != 5:
        return False
    cell, stride_px = cells(probe.size_wh, probe.grid.strides_px)
    centers = probe.grid.channels[:2]
    from_cell = np.median(np.abs(centers / stride_px - cell - 0.5))
    return bool(np.median(np.abs(centers - 0.5)) < from_cell)


def _is_boxes(name: str, output: NDArray[Any]) -> bool:
    return output.ndim >= 2 and output.shape[-1] == 4 and ('box' in name or output.shape[-2] > 1)


def _is_logits(name: str, output: NDArray[Any]) -> bool:
    is_class_table = output.ndim == 3 and not _is_boxes(name, output)
    return is_class_table and ('logit' in name or bool((output < 0).any()))


def _is_class_scores(name: str, output: NDArray[Any]) -> bool:
    is_class_table = output.ndim == 3 and not _is_boxes(name, output)
    return is_class_table and bool(((output >= 0) & (output <= 1)).all())


def _is_count(name: str, output: NDArray[Any]) -> bool:
    return 'num' in name and output.size == 1


def _is_labels(name: str, output: NDArray[Any]) -> bool:
    if _is_count(name, output) or _is_boxes(name, output) or output.ndim > 2:
        return False
    return output.dtype.kind == 'i' or any(word in name for word in ('label', 'class', 'cls'))


def _is_scores(name: str, output: NDArray[Any]) -> bool:
    taken = _is_count(name, output) or _is_boxes(name, output) or _is_labels(name, output)
    return not taken and output.ndim <= 2 and output.dtype.kind == 'f'


def _has(*kinds: Callable[[str, NDArray[Any]], bool]) -> Callable[[Probe], bool]:
    return lambda probe: all(probe.find(kind) is not None for kind in kinds)


_CENTERED = Preprocessing(rgb=True, unit_range=True, placement='centered')
_STRETCHED = Preprocessing(rgb=True, unit_range=True, placement='stretch')
_YOLOX = Preprocessing(rgb=False, unit_range=False, placement='top_left')
_is_separate = _has(_is_boxes, _is_labels, _is_scores)
_BOX = partial(_anchor_decoder, objectness=False)
_BOX_OBJECTNESS = partial(_anchor_decoder, objectness=True)
_IN_CELLS = partial(_anchor_decoder, objectness=True, in_cells=True)

LAYOUTS = (
    LayoutEntry(
        'end_to_end', _STRETCHED, False, False,
        lambda p: _is_separate(p) and _is_stretched(p), _separate_outputs_decoder,
    ),
    LayoutEntry('end_to_end', _CENTERED, False, False, _is_separate, _separate_outputs_decoder),
    LayoutEntry('detr', _STRETCHED, False, False, _has(_is_boxes, _is_logits), _logits_decoder),
    LayoutEntry(
        'yolo_nas', _CENTERED, True, False,
        _has(_is_boxes, _is_class_scores), _boxes_scores_decoder,
    ),
    LayoutEntry('end_to_end', _CENTERED, False, True, _is_finished_table, _table_decoder),
    *(
        LayoutEntry(
            name, _CENTERED, False, True, lambda _: False, partial(_table_decoder, order=order)
        )
        for name, order in TABLE_LAYOUTS.items()
    ),
    LayoutEntry('rtdetr', _STRETCHED, False, True, _is_query_table, _BOX),
    LayoutEntry('yolov8', _CENTERED, True, True, lambda p: p.num_before_classes == 4, _BOX),
    LayoutEntry('yolov5', _CENTERED, True, True, _is_yolov5, _BOX_OBJECTNESS),
    LayoutEntry('yolox_raw', _YOLOX, True, True, _is_in_cells, _IN_CELLS),
    LayoutEntry(
        'yolox', _YOLOX, True, True, lambda p: p.num_before_classes == 5, _BOX_OBJECTNESS
    ),
)  # fmt: skip
"""Known layouts, in the order in which a model is compared with them."""
