"""Decoders for layouts of finished boxes, from the outputs, their names and the metadata.

Each function `..._decoder` returns a decoder, and None as the number of classes, which finished
boxes do not show. ModelError if the outputs do not fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoid_common.coco import COCO
from hoid_common.errors import ModelError
from hoid_common.values import Float32Array
from hoid_detector.model.class_names import is_background, names_in_metadata
from hoid_detector.model.decoders import Decoder, Outputs, float32
from hoid_detector.model.finished_boxes import (
    COCO_91,
    FROM_0,
    FROM_1,
    TABLE_LAYOUTS,
    ClassIds,
    FinishedDecoder,
    Order,
    TableFormat,
    class_ids,
    known_orders,
    num_columns_of,
    order_in_name,
)
from hoid_detector.model.probe import AUTO, Probe, is_boxes, is_count, is_labels, is_scores

_PROBE_THRESHOLD = 0.25  # score threshold for the test image; default of YOLOv5's detect.py


def separate_outputs_decoder(probe: Probe, *, y_first: bool = False) -> tuple[Decoder, int | None]:
    """Return the decoder of separate boxes, labels and scores.

    With `y_first`, boxes are y1, x1, y2, x2; otherwise the output names decide.
    """
    boxes, labels = probe.find(is_boxes), probe.find(is_labels)
    scores = probe.find(is_scores, 'score')
    if boxes is None or labels is None or scores is None:
        raise probe.unknown()
    num_rows = probe.outputs[boxes].size // 4
    probe.require(probe.outputs[labels].size == num_rows == probe.outputs[scores].size)
    count = probe.find(is_count)

    def table_of(outputs: Outputs) -> Float32Array:
        parts = [float32(outputs[boxes]).reshape(-1, 4)]
        parts += [float32(outputs[i]).reshape(-1, 1) for i in (scores, labels)]
        return np.hstack(parts)[: None if count is None else _num_valid_rows(outputs[count])]

    order: Order = ('yxyx' if y_first or _is_tensorflow(probe) else 'xyxy', 'score', 'class')
    return _finished(probe, table_of, (order,)), None


def _num_valid_rows(output: NDArray[Any]) -> int:
    number = float(output.reshape(-1)[0])
    return max(int(number), 0) if np.isfinite(number) else 0


def named_columns_decoder(probe: Probe) -> tuple[Decoder, int | None]:
    """Return the decoder of boxes whose columns are in several outputs named after them."""
    order = _order_in_names(probe)
    if order is None:
        raise probe.unknown()

    def table_of(outputs: Outputs) -> Float32Array:
        return np.hstack([float32(output) for output in outputs])

    return _finished(probe, table_of, [order]), None


def has_named_columns(probe: Probe) -> bool:
    return _order_in_names(probe) is not None


def _order_in_names(probe: Probe) -> Order | None:
    shapes = [output.shape for output in probe.outputs]
    if {len(shape) for shape in shapes} != {2} or len({rows for rows, _ in shapes}) != 1:
        return None
    return order_in_name('_'.join(probe.names), sum(columns for _, columns in shapes))


def table_decoder(probe: Probe, order: Order | None = None) -> tuple[Decoder, int | None]:
    """Return the decoder of a table of finished boxes.

    Without `order`, the order that the output's name or the metadata state is used. If they state
    none, all known orders are tried until outputs exclude them.
    """
    num_columns = probe.table.shape[-1]
    stated = order or order_in_name(probe.names[0], num_columns)
    if stated is None and _is_ultralytics(probe):
        stated = TABLE_LAYOUTS['xyxy_score_class']
    orders = known_orders(num_columns) if stated is None else (stated,)
    probe.require(bool(orders) and num_columns_of(orders[0]) == num_columns)
    return _finished(probe, lambda o: float32(o[0]).reshape(-1, num_columns), orders), None


def _finished(
    probe: Probe, table_of: Callable[[Outputs], Float32Array], orders: Sequence[Order]
) -> FinishedDecoder:
    formats = [TableFormat(order, ids) for order in orders for ids in _conventions(probe)]
    decoder = FinishedDecoder(table_of, formats)
    decoder.learn(decoder.rows(probe.outputs), _PROBE_THRESHOLD)
    decoder.has_answered = False
    return decoder


def _conventions(probe: Probe) -> list[ClassIds]:
    """Return the possible conventions of class ids, the most probable one first.

    `from_0` comes last if nothing states the convention of a model with several outputs: id 0 of a
    person then excludes the others. If it came first, ids that count from 1 would hardly ever
    exclude it, and people would be reported as bicycles.
    """
    num_classes = probe.num_classes or len(COCO)
    from_1 = [COCO_91, FROM_1] if num_classes == len(COCO) else [FROM_1]
    has_background = probe.class_names is not None and is_background(probe.class_names[0])
    if probe.class_ids != AUTO:
        names = [probe.class_ids]
    elif has_background or probe.takes_size or _is_ultralytics(probe):
        names = [FROM_0]
    elif _is_tensorflow(probe):
        names = from_1
    elif len(probe.outputs) == 1 or names_in_metadata(probe.metadata) is not None:
        names = [FROM_0, *from_1]
    else:
        names = [*from_1, FROM_0]
    return [class_ids(name, num_classes) for name in names]


def _is_ultralytics(probe: Probe) -> bool:
    return probe.metadata.get('author') == 'Ultralytics'


def _is_tensorflow(probe: Probe) -> bool:
    """Return whether outputs have TensorFlow's names, which mean y before x and ids from 1."""
    return any(name.startswith('detection_boxes') for name in probe.names)


def is_stretched(probe: Probe) -> bool:
    labels = probe.find(is_labels)
    is_batched = labels is not None and probe.outputs[labels].ndim > 1
    return _is_tensorflow(probe) or (is_batched and probe.find(is_count) is None)


def is_finished_table(probe: Probe) -> bool:
    strides_px, num_columns = probe.grid.strides_px, probe.outputs[0].shape[-1]
    if strides_px and probe.metadata.get('end2end') != 'True':
        return False
    if order_in_name(probe.names[0], num_columns):
        return True
    if not known_orders(num_columns):
        return False
    # A query table (RT-DETR) with 2 or 3 classes has as many columns as a table of finished boxes.
    # But its first column is the center of the boxes, which differs between rows; in finished
    # boxes, a constant first column is the index of the image in the batch.
    rows = probe.table.reshape(-1, num_columns)
    is_constant = len(rows) > 1 and bool((rows[:, 0] == rows[0, 0]).all())
    if is_constant or not (num_columns - 4 == probe.num_classes and probe.table.ndim == 3):
        return True
    try:
        table_decoder(probe)
    except ModelError:
        return False
    return True
