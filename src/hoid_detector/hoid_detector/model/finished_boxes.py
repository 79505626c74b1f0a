"""Decoding of finished boxes: outputs after non-maximum suppression, or that need none.

Exporters write such boxes with different orders of columns and class ids. If names and metadata do
not state these, the first known format that fits the outputs for all images so far is used. A
warning names a second format that would give different boxes (decision 049).
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
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
# The column orders that exporters use, the most common ones first.
_ORDERS: tuple[Order, ...] = (
    ('xyxy', 'score', 'class'),  # YOLOv10, Ultralytics with `nms=True`
    ('xyxy', 'class', 'score'),  # YOLOv7, with the batch
    ('class', 'xyxy', 'score'),
    ('class', 'score', 'xyxy'),  # PINTO_model_zoo, with the batch
    ('yxyx', 'score', 'class'),  # TensorFlow; y before x cannot be recognized from the values
)
TABLE_LAYOUTS: Mapping[str, Order] = {
    '_'.join(order): order for o in _ORDERS for order in (o, ('batch', *o))
}
"""Orders of columns by the name of the parameter `layout` that sets them."""
_WORDS = (  # in names of outputs, such as batchno_classid_score_x1y1x2y2
    ('batch', r'batch(?:_?(?:no|id|index))?|image_?id'),
    ('xyxy', r'x1_?y1_?x2_?y2|(?<![a-z])xyxy'),
    ('yxyx', r'y1_?x1_?y2_?x2|(?<![a-z])yxyx'),
    ('score', r'scores?|conf(?:idence)?'),
    ('class', r'class(?:_?id)?|cls|label'),
)
_WORD = re.compile('|'.join(f'(?P<{word}>{pattern})' for word, pattern in _WORDS))
_YOLO_NAS = 'flat_predictions'  # output of super-gradients: batch, box, score, class

# Chosen: boxes count as fractions of the network input if no coordinate is above this, since
# fractions stay near [0, 1]. Boxes in pixels are larger than 2.
LARGEST_NORMALIZED = 2.0
MAX_SCORE = 1.1
"""Highest score that is accepted. Chosen: quantized networks exceed 1 slightly."""
_MAX_ID_ERROR = 1e-3
# Chosen: without high scores, this many boxes decide whether they are in pixels or fractions.
_MIN_WEAK_ROWS = 10


class ClassIds(NamedTuple):
    """A convention of class ids: maps each id to the index of its class name, or to -1."""

    name: str  # value of the parameter `class_ids`
    index_of_id: IntArray

    def fit(self, ids: Float32Array) -> bool:
        """Return whether all ids (N,) belong to a class; negative ids mean "no object"."""
        ids = ids[ids >= 0]
        return bool((ids < len(self.index_of_id)).all()) and bool(
            (self.index_of_id[ids.astype(np.int64)] >= 0).all()
        )


FROM_0, FROM_1, COCO_91 = 'from_0', 'from_1', 'coco_91'
CLASS_IDS = (FROM_0, FROM_1, COCO_91)


def class_ids(name: str, num_classes: int) -> ClassIds:
    index = np.arange(num_classes)
    if name == FROM_1:
        index = np.concatenate([[-1], index])
    elif name == COCO_91:
        index = np.full(COCO_IDS[-1] + 1, -1)
        index[list(COCO_IDS)] = np.arange(len(COCO))
    return ClassIds(name, index)


def order_in_name(name: str, num_columns: int) -> Order | None:
    """Return the order of columns that the name of an output states, or None if it states none."""
    if name.endswith(_YOLO_NAS):
        return ('batch', 'xyxy', 'score', 'class')
    order = tuple(str(match.lastgroup) for match in _WORD.finditer(name.lower()))
    is_complete = {'score', 'class'} < set(order) and sum(o in _BOXES for o in order) == 1
    return order if is_complete and num_columns_of(order) == num_columns else None


def known_orders(num_columns: int) -> tuple[Order, ...]:
    return tuple(
        order
        for order in TABLE_LAYOUTS.values()
        if 'xyxy' in order and num_columns_of(order) == num_columns
    )


def num_columns_of(order: Order) -> int:
    return len(order) + 3


class Columns(NamedTuple):
    """The columns of a table of N boxes, split by one order of columns."""

    boxes: Float32Array  # (N, 4) x1, y1, x2, y2
    scores: Float32Array  # (N,)
    ids: Float32Array  # (N,)
    batch: Float32Array  # (N,) index of the image in the batch, 0 without such a column

    def is_plausible(self, threshold: float) -> bool:
        """Return whether the columns can be boxes, scores and ids.

        Half of all boxes, and half of those with a score of at least the threshold, must have x1
        <= x2 and y1 <= y2; networks do not guarantee more.
        """
        is_strong = self.scores >= threshold
        is_ordered = np.asarray((self.boxes[:, 2:] >= self.boxes[:, :2]).all(axis=1))
        return (
            not self.batch.any()
            and bool((np.abs(self.scores) <= MAX_SCORE).all())
            and bool((np.abs(self.ids - np.rint(self.ids)) <= _MAX_ID_ERROR).all())
            and 2 * int(is_ordered.sum()) >= len(is_ordered)
            and 2 * int(is_ordered[is_strong].sum()) >= int(is_strong.sum())
        )


def columns(table: Float32Array, order: Order) -> Columns:
    """Split a table (N, C) into its columns; boxes become x1, y1, x2, y2."""
    at, found = 0, {}
    for word in order:
        width = 4 if word in _BOXES else 1
        found['box' if word in _BOXES else word] = table[:, at : at + width]
        at += width
    boxes = found['box'] if 'xyxy' in order else found['box'][:, [1, 0, 3, 2]]
    batch = found.get('batch', np.zeros((len(table), 1), np.float32))
    return Columns(boxes, found['score'][:, 0], found['class'][:, 0], batch[:, 0])


class TableFormat(NamedTuple):
    """An interpretation of the rows of a table: order of columns, and convention of class ids."""

    order: Order
    ids: ClassIds

    def __str__(self) -> str:
        return f'columns {"_".join(self.order)}, class ids {self.ids.name}'

    def candidates(self, table: Float32Array, threshold: float) -> Candidates:
        """Return the boxes in a table (N, C) that have a class and reach the score threshold."""
        found = columns(table, self.order)
        keep = (found.scores >= threshold) & (found.scores > 0) & (found.ids >= 0)
        index = self.ids.index_of_id[np.rint(found.ids[keep]).astype(np.int64)]
        return Candidates(found.boxes[keep], found.scores[keep], index)


@dataclass
class FinishedDecoder:
    """Decoder of finished boxes, which excludes formats that do not fit the outputs so far."""

    table_of: Callable[[Outputs], Float32Array]  # returns the (N, C) table of boxes in the outputs
    # The formats that fit all outputs so far; the first one is used.
    formats: Sequence[TableFormat]
    # True: boxes are fractions of the input; False: pixels; None: not known yet.
    normalized: bool | None = None
    has_answered: bool = False  # whether an image has had a box above the threshold
    reported: set[str] = field(default_factory=set)  # other formats that a warning has named

    def __call__(self, outputs: Outputs, size_wh: Size, score_threshold: float) -> Candidates:
        table = self.rows(outputs)
        self.learn(table, score_threshold)
        found = self.formats[0].candidates(table, score_threshold)
        self._report_doubt(table, found, score_threshold)
        return in_pixels(found, size_wh, normalized=bool(self.normalized))

    def rows(self, outputs: Outputs) -> Float32Array:
        """Return the rows (N, C) of the outputs without padding and without non-finite rows.

        In a padding row, all values from the second column on are equal.
        """
        table = self.table_of(outputs)
        table = table[np.isfinite(table).all(axis=1)]
        rows: Float32Array = table[(table[:, 1:] != table[:, -1:]).any(axis=1)]
        return rows

    def learn(self, table: Float32Array, threshold: float) -> None:
        """Drop formats that a table (N, C) refutes; set `normalized`; ModelError if none fits."""
        orders = dict.fromkeys(table_format.order for table_format in self.formats)
        plausible = {
            order: found
            for order in orders
            if (found := columns(table, order)).is_plausible(threshold)
        }
        if not plausible:
            raise ModelError(
                f'the answer fits no known order of columns: the first row is {_text(table[0])}; '
                f'set the parameter "layout" to one of {", ".join(TABLE_LAYOUTS)}'
            )
        ids = {order: np.rint(f.ids[f.scores > 0]) for order, f in plausible.items()}
        formats = [r for r in self.formats if r.order in ids and r.ids.fit(ids[r.order])]
        if not formats:
            seen = _text(np.unique(next(iter(ids.values()))))
            raise ModelError(
                f'the answer contains the class ids {seen}, which do not fit the class names; set '
                'class_names_file or class_ids, or the parameter "layout"'
            )
        if self.has_answered and str(formats[0]) != str(self.formats[0]):
            _LOG.warning(
                'detector: earlier boxes were read in a wrong layout; it is now %s', formats[0]
            )
        self.formats = formats
        found = plausible[formats[0].order]
        self.has_answered |= bool((found.scores >= threshold).any())
        if self.normalized is None:
            self.normalized = _are_normalized(found, threshold)

    def _report_doubt(self, table: Float32Array, found: Candidates, threshold: float) -> None:
        for other in self.formats[1:]:
            if str(other) not in self.reported and not _are_equal(
                found, other.candidates(table, threshold)
            ):
                self.reported.add(str(other))
                _LOG.warning(
                    'detector: boxes are read as %s, but may be %s; the first row is %s; set the '
                    'parameters "layout" and "class_ids" to what is right',
                    self.formats[0], other, _text(table[0]),
                )  # fmt: skip


def _are_normalized(found: Columns, threshold: float) -> bool | None:
    """Return whether boxes are fractions of the input; None if too few boxes can tell."""
    is_strong = found.scores >= threshold
    if is_strong.any():
        boxes = found.boxes[is_strong]
    else:
        has_area = (found.boxes[:, 2:] > found.boxes[:, :2]).all(axis=1)
        boxes = found.boxes[has_area]
        if len(boxes) < _MIN_WEAK_ROWS:
            return None
    return bool(np.abs(boxes).max() <= LARGEST_NORMALIZED)


def _are_equal(found: Candidates, other: Candidates) -> bool:
    return (
        np.array_equal(found.class_ids, other.class_ids)
        and np.array_equal(found.scores, other.scores)
        and np.array_equal(found.boxes_xyxy_px, other.boxes_xyxy_px)
    )


def _text(values: NDArray[Any]) -> str:
    return ' '.join(f'{value:g}' for value in values[:8])
