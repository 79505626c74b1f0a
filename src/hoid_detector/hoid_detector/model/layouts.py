"""Output layouts of detection networks, and recognition of the layout that a model has.

| layout | output | input |
|---|---|---|
| `yolov8` | 4 + C channels for each grid cell (YOLOv8, 9, 11) | RGB 0-1, centered |
| `yolov5` | 5 + C channels for 3 anchors a cell (YOLOv5, 7), or 1 (YOLOv6) | RGB 0-1, centered |
| `yolox_raw`, `yolox` | 5 + C channels a cell, in cell units or pixels | BGR 0-255, top left |
| `rtdetr` | 4 + C channels a query (RT-DETR by Ultralytics) | RGB 0-1, stretched |
| `end_to_end` | N x 6 (YOLOv10), N x 7 (YOLOv7) | RGB 0-1, centered |
| `end_to_end` | boxes, labels, scores (RT-DETR, D-FINE) | RGB 0-1, stretched |
| `detr` | logits, boxes (RT-DETR, D-FINE as exported by Transformers) | RGB 0-1, stretched |

`LAYOUTS` is the registry: one entry there adds a layout, also to the parameter `layout`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import ModelError
from hoid_common.values import Float32Array
from hoid_detector.model.decoders import (
    AnchorDecoder,
    Decoder,
    LogitsDecoder,
    SeparateOutputsDecoder,
    Size,
    TableDecoder,
    cells,
)

AUTO = 'auto'
"""Value of a parameter that follows from the model file."""

# Grid strides of the published YOLO models, the usual ones (P3 to P5) first.
_STRIDES_PX = ((8, 16, 32), (8, 16, 32, 64), (4, 8, 16, 32), (16, 32), (8, 16), (8,), (16,))
# Chosen: fractions of the input stay near [0, 1], and no object has a box of 2 pixels.
_LARGEST_NORMALIZED = 2.0
_COCO_CLASSES = 80


class Preprocessing(NamedTuple):
    """Input format of a network."""

    rgb: bool  # else BGR
    unit_range: bool  # values from 0 to 1, else 0 to 255
    placement: str  # of the image in the input: 'centered', 'top_left' or 'stretch'

    def __str__(self) -> str:
        order = 'RGB' if self.rgb else 'BGR'
        return f'{order} {"0-1" if self.unit_range else "0-255"}, {self.placement}'


class Grid(NamedTuple):
    """A single output as channels of anchors, and the grid cells that its anchors lie on."""

    channels: Float32Array  # (C, N)
    anchors_last: bool  # whether the output is (C, N) itself, else (N, C)
    strides_px: tuple[int, ...]  # empty where the number of anchors fits no grid
    anchors_per_cell: int


@dataclass(frozen=True, eq=False)
class Probe:
    """Outputs of a network for a test image, from which its layout is recognized."""

    size_wh: Size  # of the network input
    names: tuple[str, ...]  # of the outputs
    outputs: tuple[NDArray[Any], ...]
    metadata: Mapping[str, str]
    num_classes: int | None  # number of class names, where they are known
    box_units: str = AUTO  # AUTO, 'pixel' or 'normalized'

    def __str__(self) -> str:
        found = zip(self.names, self.outputs, strict=True)
        return ', '.join(f'{name} {a.dtype} {"x".join(map(str, a.shape))}' for name, a in found)

    @property
    def table(self) -> NDArray[Any]:
        """Return the single output, (rows, columns) or (1, rows, columns).

        Raises:
            ModelError: It has another shape.
        """
        output = self.outputs[0]
        self.require(output.ndim == 2 or (output.ndim == 3 and output.shape[0] == 1))
        return output

    @cached_property
    def grid(self) -> Grid:
        """Return the single output as a grid of anchors; raise ModelError if it is no table."""
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
        """Return 4 (box) or 5 (box, objectness), or None where the output is no grid of anchors.

        Without class names, models with COCO's 80 classes are recognized. Others are assumed to
        have no objectness where the channels come before the anchors, as YOLOv8 exports them.
        """
        channels, anchors_last, strides_px, _ = self.grid
        num, with_box = len(channels), 4 if anchors_last else 5
        num_classes = self.num_classes
        if num_classes is None:
            is_coco = num in (4 + _COCO_CLASSES, 5 + _COCO_CLASSES)
            num_classes = _COCO_CLASSES if is_coco else num - with_box
        before = num - num_classes
        return before if strides_px and before in (4, 5) else None

    def find(self, matches: Callable[[str, NDArray[Any]], bool]) -> int | None:
        """Return the index of the first output that matches by its lower-case name and values."""
        named = enumerate(zip(self.names, self.outputs, strict=True))
        return next((i for i, (name, a) in named if matches(name.lower(), a)), None)

    def is_normalized(self, boxes: NDArray[Any]) -> bool:
        """Return whether boxes are fractions of the input; where there is no box, they are not."""
        if self.box_units != AUTO:
            return self.box_units == 'normalized'
        return 0 < float(np.abs(boxes).max(initial=0)) <= _LARGEST_NORMALIZED

    def require(self, condition: bool) -> None:
        """Raise the ModelError of an unknown layout unless the condition holds."""
        if not condition:
            raise self.unknown()

    def unknown(self) -> ModelError:
        """Return the error of a model whose layout is none of the known ones."""
        width, height = self.size_wh
        names = '' if self.num_classes is None else f' and {self.num_classes} class names'
        task = f', task {self.metadata["task"]}' if 'task' in self.metadata else ''
        return ModelError(
            f'unknown output layout: {self} at input {width}x{height}{names}{task}; '
            f'export a plain detection model, or set the parameter "layout"'
        )


class Layout(NamedTuple):
    """Input format of a network and decoder of its outputs."""

    name: str
    preprocessing: Preprocessing
    decode: Decoder
    num_classes: int | None  # None where the output does not show it
    needs_nms: bool


@dataclass(frozen=True)
class LayoutEntry:
    """A known layout: how it is recognized and decoded."""

    name: str  # value of the parameter `layout`
    preprocessing: Preprocessing  # of the networks that are published with this layout
    needs_nms: bool
    has_one_output: bool
    matches: Callable[[Probe], bool]  # whether a probe looks like this layout
    decoder: Callable[[Probe], tuple[Decoder, int | None]]  # with the number of classes


def recognize(probe: Probe, requested: str = AUTO) -> Layout:
    """Return the layout of a network.

    Args:
        probe: Outputs for a test image.
        requested: Name of a layout, or AUTO for the first entry of `LAYOUTS` that matches.

    Raises:
        ModelError: The outputs have no known layout, or not the requested one.
    """
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
    num_classes = probe.outputs[logits].shape[-1]
    probe.require(0 < num_classes == (probe.num_classes or num_classes))
    probe.require(probe.outputs[boxes].shape[:-1] == probe.outputs[logits].shape[:-1])
    return LogitsDecoder(boxes, logits), num_classes


def _separate_outputs_decoder(probe: Probe) -> tuple[Decoder, int | None]:
    boxes, labels, scores = (probe.find(m) for m in (_is_boxes, _is_labels, _is_scores))
    if boxes is None or labels is None or scores is None:
        raise probe.unknown()
    num_rows = probe.outputs[boxes].size // 4
    probe.require(probe.outputs[labels].size == num_rows == probe.outputs[scores].size)
    normalized = probe.is_normalized(probe.outputs[boxes])
    count = probe.find(_is_count)
    return SeparateOutputsDecoder(boxes, labels, scores, count, normalized), None


def _table_decoder(probe: Probe) -> tuple[Decoder, int | None]:
    num_columns = probe.table.shape[-1]
    probe.require(num_columns in (6, 7))
    boxes = slice(0, 4) if num_columns == 6 else slice(1, 5)
    return TableDecoder(probe.is_normalized(probe.table[..., boxes])), None


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
    strides_px, shape = probe.grid.strides_px, probe.outputs[0].shape
    has_columns = shape[-1] == 6 or (shape[-1] == 7 and len(shape) == 2)
    return has_columns and (not strides_px or probe.metadata.get('end2end') == 'True')


def _is_query_table(probe: Probe) -> bool:
    grid = probe.grid
    return not grid.strides_px and not grid.anchors_last and len(grid.channels) > 4


def _is_yolov5(probe: Probe) -> bool:
    """Return whether cells have 3 anchors each, or objectness is 1 throughout as in YOLOv6."""
    grid = probe.grid
    return probe.num_before_classes == 5 and (
        grid.anchors_per_cell == 3 or bool((grid.channels[4] == 1).all())
    )


def _is_in_cells(probe: Probe) -> bool:
    """Return whether box centers fit their cells better as offsets in cells than as pixels."""
    if probe.num_before_classes != 5:
        return False
    cell, stride_px = cells(probe.size_wh, probe.grid.strides_px)
    centers = probe.grid.channels[:2]
    from_cell = np.median(np.abs(centers / stride_px - cell - 0.5))
    return bool(np.median(np.abs(centers - 0.5)) < from_cell)


def _is_boxes(name: str, output: NDArray[Any]) -> bool:
    return output.ndim >= 2 and output.shape[-1] == 4 and ('box' in name or output.shape[-2] > 1)


def _is_logits(name: str, output: NDArray[Any]) -> bool:
    return 'logit' in name and output.ndim == 3


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
_BOX = partial(_anchor_decoder, objectness=False)
_BOX_OBJECTNESS = partial(_anchor_decoder, objectness=True)
_IN_CELLS = partial(_anchor_decoder, objectness=True, in_cells=True)

LAYOUTS = (
    LayoutEntry('detr', _STRETCHED, False, False, _has(_is_boxes, _is_logits), _logits_decoder),
    LayoutEntry(
        'end_to_end', _STRETCHED, False, False,
        _has(_is_boxes, _is_labels, _is_scores), _separate_outputs_decoder,
    ),
    LayoutEntry('end_to_end', _CENTERED, False, True, _is_finished_table, _table_decoder),
    LayoutEntry('rtdetr', _STRETCHED, False, True, _is_query_table, _BOX),
    LayoutEntry('yolov8', _CENTERED, True, True, lambda p: p.num_before_classes == 4, _BOX),
    LayoutEntry('yolov5', _CENTERED, True, True, _is_yolov5, _BOX_OBJECTNESS),
    LayoutEntry('yolox_raw', _YOLOX, True, True, _is_in_cells, _IN_CELLS),
    LayoutEntry(
        'yolox', _YOLOX, True, True, lambda p: p.num_before_classes == 5, _BOX_OBJECTNESS
    ),
)  # fmt: skip
"""Known layouts, in the order in which a model is compared with them."""
