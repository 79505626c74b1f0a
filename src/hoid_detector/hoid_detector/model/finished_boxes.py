"""Finished boxes: outputs after non-maximum suppression, or of networks that need none.

Exporters write the same boxes with different columns and class ids. Both follow from the names of
the outputs and the metadata where these state them. Otherwise the first known convention is used
that fits all answers so far; answers that fit none are refused.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.coco import COCO, COCO_IDS
from hoid_common.errors import ModelError
from hoid_common.values import Float32Array, IntArray
from hoid_detector.model.decoders import Candidates, Outputs, Size, in_pixels

_LOG = logging.getLogger(__name__)

Order = tuple[str, ...]
"""Meaning of the columns of a table: 'batch', 'xyxy' or 'yxyx' (4 columns), 'score', 'class'."""

_BOXES = ('xyxy', 'yxyx')
# The orders that exporters use, the more common ones first.
_ORDERS: tuple[Order, ...] = (
    ('xyxy', 'score', 'class'),  # YOLOv10, Ultralytics with `nms=True`
    ('xyxy', 'class', 'score'),  # YOLOv7, with the batch
    ('class', 'xyxy', 'score'),
    ('class', 'score', 'xyxy'),  # PINTO_model_zoo, with the batch
)
TABLE_LAYOUTS: Mapping[str, Order] = {
    '_'.join(order): order for o in _ORDERS for order in (o, ('batch', *o))
}
"""Orders of columns by the name of the parameter `layout` that sets them."""
_WORDS = (  # of the names of outputs, such as batchno_classid_score_x1y1x2y2
    ('batch', r'batch(?:_?(?:no|id|index))?|image_?id'),
    ('xyxy', r'x1_?y1_?x2_?y2|(?<![a-z])xyxy'),
    ('yxyx', r'y1_?x1_?y2_?x2|(?<![a-z])yxyx'),
    ('score', r'scores?|conf(?:idence)?'),
    ('class', r'class(?:_?id)?|cls|label'),
)
_WORD = re.compile('|'.join(f'(?P<{word}>{pattern})' for word, pattern in _WORDS))
_YOLO_NAS = 'flat_predictions'  # of super-gradients: batch, box, score, class

# Chosen: fractions of the input stay near [0, 1], and no object has a box of 2 pixels.
LARGEST_NORMALIZED = 2.0
MAX_SCORE = 1.1
"""Highest score that is accepted. Chosen: quantized networks exceed 1 slightly."""
_MAX_ID_ERROR = 1e-3
_MIN_WEAK_ROWS = 10  # chosen: so many boxes of low scores show their unit as well


class ClassIds(NamedTuple):
    """A convention of class ids: the index of the class name by id, -1 for ids without a class."""

    name: str  # value of the parameter `class_ids`
    index_of_id: IntArray

    def fit(self, ids: Float32Array) -> bool:
        """Return whether all (N,) ids belong to a class; negative ones mark no object."""
        ids = ids[ids >= 0]
        return bool((ids < len(self.index_of_id)).all()) and bool(
            (self.index_of_id[ids.astype(np.int64)] >= 0).all()
        )


FROM_0, FROM_1, COCO_91 = 'from_0', 'from_1', 'coco_91'
CLASS_IDS = (FROM_0, FROM_1, COCO_91)


def class_ids(name: str, num_classes: int) -> ClassIds:
    """Return the convention of this name for a number of class names."""
    index = np.arange(num_classes)
    if name == FROM_1:
        index = np.concatenate([[-1], index])
    elif name == COCO_91:
        index = np.full(COCO_IDS[-1] + 1, -1)
        index[list(COCO_IDS)] = np.arange(len(COCO))
    return ClassIds(name, index)


def order_in_name(name: str, num_columns: int) -> Order | None:
    """Return the order of columns that the name of an output states, or None."""
    if name.endswith(_YOLO_NAS):
        return ('batch', 'xyxy', 'score', 'class')
    order = tuple(str(match.lastgroup) for match in _WORD.finditer(name.lower()))
    is_complete = {'score', 'class'} < set(order) and sum(o in _BOXES for o in order) == 1
    return order if is_complete and _width(order) == num_columns else None


def known_orders(num_columns: int) -> tuple[Order, ...]:
    """Return the orders that a table with so many columns may have."""
    return tuple(order for order in TABLE_LAYOUTS.values() if _width(order) == num_columns)


class Columns(NamedTuple):
    """The columns of a table of N boxes, in one order of columns."""

    boxes: Float32Array  # (N, 4) x1, y1, x2, y2
    scores: Float32Array  # (N,)
    ids: Float32Array  # (N,)
    batch: Float32Array  # (N,), 0 without such a column

    def is_plausible(self, threshold: float) -> bool:
        """Return whether these can be boxes, scores and ids.

        Boxes with a score below the threshold may have any corners, and a few others as well, as
        networks do not guarantee their order.
        """
        ids = self.ids[self.scores > 0]
        is_strong = self.scores >= threshold
        ordered = (self.boxes[is_strong, 2:] >= self.boxes[is_strong, :2]).all(axis=1)
        return (
            not self.batch.any()
            and bool((np.abs(self.scores) <= MAX_SCORE).all())
            and bool((np.abs(ids - np.rint(ids)) <= _MAX_ID_ERROR).all())
            and 2 * int(ordered.sum()) >= int(is_strong.sum())
        )


def columns(table: Float32Array, order: Order) -> Columns:
    """Return the columns of a (N, C) table."""
    at, found = 0, {}
    for word in order:
        width = 4 if word in _BOXES else 1
        found['box' if word in _BOXES else word] = table[:, at : at + width]
        at += width
    boxes = found['box'] if 'xyxy' in order else found['box'][:, [1, 0, 3, 2]]
    batch = found.get('batch', np.zeros((len(table), 1), np.float32))
    return Columns(boxes, found['score'][:, 0], found['class'][:, 0], batch[:, 0])


@dataclass
class FinishedDecoder:
    """Decoder of finished boxes. It learns from each answer which convention the outputs have."""

    table_of: Callable[[Outputs], Float32Array]  # returns the (N, C) table of the outputs
    orders: Sequence[Order]  # that fit all answers so far; the first is used
    ids: Sequence[ClassIds]  # the same
    normalized: bool | None  # boxes are fractions of the input, else pixels; None: not known yet
    has_answered: bool = False  # whether an answer had a box above the threshold

    def __call__(self, outputs: Outputs, size_wh: Size, score_threshold: float) -> Candidates:
        """Return the candidates whose score is at least the threshold.

        Raises:
            ModelError: The outputs fit no order of columns or no convention of class ids.
        """
        table = self.rows(outputs)
        self.learn(table, score_threshold)
        found = columns(table, self.orders[0])
        keep = (found.scores >= score_threshold) & (found.ids >= 0)
        index = self.ids[0].index_of_id[np.rint(found.ids[keep]).astype(np.int64)]
        candidates = Candidates(found.boxes[keep], found.scores[keep], index)
        return in_pixels(candidates, size_wh, normalized=bool(self.normalized))

    def rows(self, outputs: Outputs) -> Float32Array:
        """Return the rows of the table without padding and without those that are not finite."""
        table = self.table_of(outputs)
        table = table[np.isfinite(table).all(axis=1)]
        rows: Float32Array = table[(table[:, 1:] != table[:, -1:]).any(axis=1)]
        return rows

    def learn(self, table: Float32Array, threshold: float) -> None:
        """Exclude what does not fit the rows of an answer."""
        orders = [o for o in self.orders if columns(table, o).is_plausible(threshold)]
        if not orders:
            raise ModelError(
                f'the answer fits no known order of columns: the first row is {_text(table[0])}; '
                f'set the parameter "layout" to one of {", ".join(TABLE_LAYOUTS)}'
            )
        found = columns(table, orders[0])
        ids = np.rint(found.ids[found.scores > 0])
        conventions = [c for c in self.ids if c.fit(ids)]
        if not conventions:
            raise ModelError(
                f'the answer contains the class ids {_text(np.unique(ids))}, which do not fit the '
                'class names; set class_names_file or class_ids, or the parameter "layout"'
            )
        is_new = (orders[0], conventions[0].name) != (self.orders[0], self.ids[0].name)
        if is_new and self.has_answered:
            order, name = '_'.join(orders[0]), conventions[0].name
            _LOG.warning('detector: earlier boxes were misread: columns %s, ids %s', order, name)
        self.orders, self.ids = orders, conventions
        self.has_answered |= bool((found.scores >= threshold).any())
        if self.normalized is None:
            strong = found.boxes[found.scores >= threshold]
            boxes = strong if len(strong) else found.boxes
            if len(strong) or len(boxes) >= _MIN_WEAK_ROWS:
                self.normalized = bool(np.abs(boxes).max() <= LARGEST_NORMALIZED)


def _width(order: Order) -> int:
    return len(order) + 3


def _text(values: NDArray[Any]) -> str:
    return ' '.join(f'{value:g}' for value in values[:8])
