"""The outputs of a network for a test image, and properties that reveal its layout."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.coco import COCO
from hoid_common.errors import ModelError
from hoid_common.values import Float32Array
from hoid_detector.model.decoders import Size, cells
from hoid_detector.model.finished_boxes import LARGEST_NORMALIZED

AUTO = 'auto'
"""Value of a parameter that follows from the model file."""

# Grid strides of the published YOLO models, the usual ones (P3 to P5) first.
_STRIDES_PX = ((8, 16, 32), (8, 16, 32, 64), (4, 8, 16, 32), (16, 32), (8, 16), (8,), (16,))
_CLASS_WORDS = ('label', 'class', 'cls', 'logit', 'score')


class Grid(NamedTuple):
    """A single output as channels of N anchors, and the grid cells to which the anchors belong."""

    channels: Float32Array  # (C, N)
    anchors_last: bool  # True: the output is (C, N); False: (N, C)
    strides_px: tuple[int, ...]  # empty if the number of anchors fits no grid
    anchors_per_cell: int  # 0 if the number of anchors fits no grid


@dataclass(frozen=True, eq=False)
class Probe:
    """The outputs of a network for a test image, from which its layout is recognized."""

    size_wh: Size  # width and height of the network input
    names: tuple[str, ...]  # names of the outputs
    outputs: tuple[NDArray[Any], ...]
    metadata: Mapping[str, str]
    class_names: tuple[str, ...] | None  # None if they are not known
    class_ids: str = AUTO  # AUTO, or the convention of class ids
    takes_size: bool = False  # whether the network has an input for the image size

    def __str__(self) -> str:
        found = zip(self.names, self.outputs, strict=True)
        return ', '.join(f'{name} {a.dtype} {"x".join(map(str, a.shape))}' for name, a in found)

    @property
    def num_classes(self) -> int | None:
        return None if self.class_names is None else len(self.class_names)

    @property
    def table(self) -> NDArray[Any]:
        """Return the first output, of shape (A, B) or (1, A, B); ModelError for another shape."""
        output = self.outputs[0]
        self.require(output.ndim == 2 or (output.ndim == 3 and output.shape[0] == 1))
        return output

    @cached_property
    def grid(self) -> Grid:
        table: Float32Array = np.asarray(self.table, np.float32).reshape(self.table.shape[-2:])
        for strides in _STRIDES_PX:
            num_cells = len(cells(self.size_wh, strides)[1])
            for last in (True, False):
                anchors, channels = table.shape[::-1] if last else table.shape
                if anchors in (num_cells, 3 * num_cells) and channels > 4:
                    return Grid(table if last else table.T, last, strides, anchors // num_cells)
        last = table.shape[1] > table.shape[0]
        return Grid(table if last else table.T, last, (), 0)

    @property
    def num_before_classes(self) -> int | None:
        """Return the number of channels before class scores: 4, or 5 (objectness); None: no grid.

        If class names are not known, 80 classes as in COCO are assumed if they fit. Other models
        are assumed to lack objectness if the channels precede the anchors, as in YOLOv8 exports.
        """
        channels, anchors_last, strides_px, _ = self.grid
        num, with_box = len(channels), 4 if anchors_last else 5
        num_classes = self.num_classes
        if num_classes is None:
            is_coco = num in (4 + len(COCO), 5 + len(COCO))
            num_classes = len(COCO) if is_coco else num - with_box
        before = num - num_classes
        return before if strides_px and before in (4, 5) else None

    def find(self, matches: Callable[[str, NDArray[Any]], bool], word: str = '') -> int | None:
        """Return the index of the first matching output, with `word` in its name if possible."""
        named = enumerate(zip(self.names, self.outputs, strict=True))
        found = [i for i, (name, a) in named if matches(name.lower(), a)]
        return min(found, key=lambda i: word not in self.names[i].lower(), default=None)

    def is_normalized(self, boxes: NDArray[Any]) -> bool:
        return 0 < float(np.abs(boxes).max(initial=0)) <= LARGEST_NORMALIZED

    def require(self, condition: bool) -> None:
        if not condition:
            raise self.unknown()

    def unknown(self) -> ModelError:
        width, height = self.size_wh
        names = '' if self.num_classes is None else f' and {self.num_classes} class names'
        task = f', task {self.metadata["task"]}' if 'task' in self.metadata else ''
        return ModelError(
            f'unknown output layout: {self} at input {width}x{height}{names}{task}; '
            f'export a plain detection model, or set the parameter "layout"'
        )


def is_boxes(name: str, output: NDArray[Any]) -> bool:
    """Return whether an output has boxes, and not the scores of four classes."""
    has_shape = output.ndim >= 2 and output.shape[-1] == 4
    return has_shape and ('box' in name or not any(word in name for word in _CLASS_WORDS))


def is_logits(name: str, output: NDArray[Any]) -> bool:
    return _is_class_table(name, output) and ('logit' in name or bool((output < 0).any()))


def is_class_scores(name: str, output: NDArray[Any]) -> bool:
    return _is_class_table(name, output) and bool(((output >= 0) & (output <= 1)).all())


def is_count(name: str, output: NDArray[Any]) -> bool:
    return 'num' in name and output.size == 1


def is_labels(name: str, output: NDArray[Any]) -> bool:
    if is_count(name, output) or is_boxes(name, output) or output.ndim > 2:
        return False
    return output.dtype.kind == 'i' or any(word in name for word in ('label', 'class', 'cls'))


def is_scores(name: str, output: NDArray[Any]) -> bool:
    taken = is_count(name, output) or is_boxes(name, output) or is_labels(name, output)
    return not taken and output.ndim <= 2 and output.dtype.kind == 'f'


def _is_class_table(name: str, output: NDArray[Any]) -> bool:
    return output.ndim == 3 and not is_boxes(name, output)


def is_no_object_last(logits: NDArray[Any]) -> bool:
    """Return whether the last of C classes is "no object", by the logits (1, N, C) for noise.

    In an image of noise, a network with that class (softmax) reports it; a network with a sigmoid
    per class reports no class.
    """
    is_last = logits.argmax(axis=-1) == logits.shape[-1] - 1
    return 2 * int(np.count_nonzero(is_last)) > int(is_last.size)
