"""Which layout a model's output has, told from its answer to one test image and from its metadata.

| layout | output | input |
|---|---|---|
| `yolov8` | 4 + C channels for each grid cell (YOLOv8, 9, 11) | RGB 0-1, centred |
| `yolov5` | 5 + C channels for 3 anchors a cell (YOLOv5, 7), or 1 (YOLOv6) | RGB 0-1, centred |
| `yolox_raw`, `yolox` | 5 + C channels a cell, in cell units or pixels | BGR 0-255, top left |
| `rtdetr` | 4 + C channels a query (RT-DETR by Ultralytics) | RGB 0-1, stretched |
| `end_to_end` | N x 6 (YOLOv10), N x 7 (YOLOv7) | RGB 0-1, centred |
| `end_to_end` | boxes, labels, scores (RT-DETR, D-FINE) | RGB 0-1, stretched |
| `detr` | logits, boxes (RT-DETR, D-FINE as exported by Transformers) | RGB 0-1, stretched |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import ModelError
from hoid_common.values import Float32Array
from hoid_detector.config import AUTO, DetectorConfig
from hoid_detector.model.decoders import (
    AnchorDecoder,
    Decoder,
    EndToEndDecoder,
    LogitsDecoder,
    Size,
    SplitDecoder,
    cells,
)
from hoid_detector.model.letterbox import Preprocessing

_STRIDES_PX = ((8, 16, 32), (8, 16, 32, 64), (4, 8, 16, 32), (16, 32), (8, 16), (8,), (16,))
_LARGEST_NORMALIZED = 2.0  # fractions stay near [0, 1]; boxes of 2 pixels are no objects
_COCO_CLASSES = 80


@dataclass(frozen=True, eq=False)
class Probe:
    """What a network made of a test image."""

    size_wh: Size  # of the network input
    names: tuple[str, ...]  # of the outputs
    outputs: tuple[NDArray[Any], ...]
    metadata: Mapping[str, str]
    num_classes: int | None  # as far as a list of names is known

    def __str__(self) -> str:
        found = zip(self.names, self.outputs, strict=True)
        return ', '.join(f'{name} {a.dtype} {"x".join(map(str, a.shape))}' for name, a in found)


class Layout(NamedTuple):
    """How to feed a network and read its answer."""

    name: str
    preprocessing: Preprocessing
    decode: Decoder
    num_classes: int | None  # None where the output does not tell
    needs_nms: bool


def recognize(probe: Probe, config: DetectorConfig) -> Layout:
    """Return the layout; raises ModelError, saying what was found, when it is none known."""
    if len(probe.outputs) == 1:
        return _of_one_output(probe, config)
    boxes, logits = _find(probe, _is_boxes), _find(probe, _is_logits)
    labels, scores = _find(probe, _is_labels), _find(probe, _is_scores)
    preprocessing = _preprocessing(config, 'stretch')
    if config.layout in (AUTO, 'detr') and boxes is not None and logits is not None:
        num_classes = probe.outputs[logits].shape[-1]
        _require(0 < num_classes == (probe.num_classes or num_classes), probe)
        _require(probe.outputs[boxes].shape[:-1] == probe.outputs[logits].shape[:-1], probe)
        decode = LogitsDecoder(boxes, logits)
        return Layout('detr', preprocessing, decode, num_classes, needs_nms=False)
    if (
        config.layout not in (AUTO, 'end_to_end')
        or boxes is None
        or labels is None
        or scores is None
    ):
        raise _unknown(probe)
    rows = probe.outputs[boxes].size // 4
    _require(probe.outputs[labels].size == rows == probe.outputs[scores].size, probe)
    normalized = _normalized(probe.outputs[boxes], config)
    split = SplitDecoder(boxes, labels, scores, _find(probe, _is_count), normalized)
    return Layout('end_to_end', preprocessing, split, None, needs_nms=False)


def _of_one_output(probe: Probe, config: DetectorConfig) -> Layout:
    output = probe.outputs[0]
    _require(output.ndim == 2 or (output.ndim == 3 and output.shape[0] == 1), probe)
    grid = _Grid.of(probe)
    kind = config.layout if config.layout != AUTO else _kind(probe, grid)
    if kind == 'end_to_end':
        _require(output.shape[-1] in (6, 7), probe)
        columns = slice(0, 4) if output.shape[-1] == 6 else slice(1, 5)
        end_to_end = EndToEndDecoder(_normalized(output[..., columns], config))
        preprocessing = _preprocessing(config, 'centered')
        return Layout(kind, preprocessing, end_to_end, None, needs_nms=False)
    raw, yolox = kind == 'yolox_raw', kind in ('yolox', 'yolox_raw')
    objectness = yolox or kind == 'yolov5'
    num_classes = len(grid.channels) - (5 if objectness else 4)
    _require(num_classes >= 1 and num_classes == (probe.num_classes or num_classes), probe)
    _require(output.ndim == 3 and kind != 'detr' and (bool(grid.strides_px) or not raw), probe)
    decode = AnchorDecoder(
        anchors_last=grid.anchors_last,
        objectness=objectness,
        normalized=not raw and _normalized(grid.channels[:4], config),
        raw_strides_px=grid.strides_px if raw else (),
    )
    placement = 'top_left' if yolox else 'stretch' if kind == 'rtdetr' else 'centered'
    preprocessing = _preprocessing(config, placement, yolox=yolox)
    return Layout(kind, preprocessing, decode, num_classes, needs_nms=kind != 'rtdetr')


class _Grid(NamedTuple):
    """How the anchors of an output lie on the cells of the input; no strides: they do not."""

    channels: Float32Array  # (C, N)
    anchors_last: bool
    strides_px: tuple[int, ...]
    anchors_per_cell: int

    @classmethod
    def of(cls, probe: Probe) -> _Grid:
        table: Float32Array = np.asarray(probe.outputs[0], np.float32).reshape(
            probe.outputs[0].shape[-2:]
        )
        for strides in _STRIDES_PX:
            num_cells = len(cells(probe.size_wh, strides)[1])
            for last in (True, False):
                anchors, channels = table.shape[::-1] if last else table.shape
                if anchors in (num_cells, 3 * num_cells) and channels > 4:
                    return cls(table if last else table.T, last, strides, anchors // num_cells)
        last = table.shape[1] > table.shape[0]
        return cls(table if last else table.T, last, (), 0)


def _kind(probe: Probe, grid: _Grid) -> str:
    shape = probe.outputs[0].shape
    num_channels = grid.channels.shape[0]
    finished = shape[-1] == 6 or (shape[-1] == 7 and len(shape) == 2)
    if finished and (not grid.strides_px or probe.metadata.get('end2end') == 'True'):
        return 'end_to_end'
    if not grid.strides_px:
        _require(num_channels > 4 and not grid.anchors_last, probe)
        return 'rtdetr'
    num_classes = probe.num_classes
    if num_classes is None:
        # 4 + C channels stand before the anchors, 5 + C behind, but for COCO's number.
        known = num_channels in (4 + _COCO_CLASSES, 5 + _COCO_CLASSES)
        num_classes = _COCO_CLASSES if known else num_channels - (4 if grid.anchors_last else 5)
    _require(num_channels in (4 + num_classes, 5 + num_classes), probe)
    if num_channels == 4 + num_classes:
        return 'yolov8'
    if grid.anchors_per_cell == 3 or bool((grid.channels[4] == 1).all()):  # YOLOv6: all ones
        return 'yolov5'
    return 'yolox_raw' if _is_raw(probe.size_wh, grid) else 'yolox'


def _is_raw(size_wh: Size, grid: _Grid) -> bool:
    """Return whether box centres read as offsets within their cells are nearer to them."""
    cell, stride_px = cells(size_wh, grid.strides_px)
    centers = grid.channels[:2]
    from_cell = np.median(np.abs(centers / stride_px - cell - 0.5))
    return bool(np.median(np.abs(centers - 0.5)) < from_cell)


def _normalized(boxes: NDArray[Any], config: DetectorConfig) -> bool:
    """Return whether boxes are fractions; without a box in the test image, they are pixels."""
    if config.box_units != AUTO:
        return config.box_units == 'normalized'
    return 0 < float(np.abs(boxes).max(initial=0)) <= _LARGEST_NORMALIZED


def _preprocessing(
    config: DetectorConfig, placement: str, *, yolox: bool = False
) -> Preprocessing:
    return Preprocessing(
        rgb=not yolox if config.color_order == AUTO else config.color_order == 'rgb',
        unit_range=not yolox if config.value_range == AUTO else config.value_range == 'unit',
        placement=placement if config.letterbox == AUTO else config.letterbox,
    )


def _find(probe: Probe, is_it: Callable[[str, NDArray[Any]], bool]) -> int | None:
    named = enumerate(zip(probe.names, probe.outputs, strict=True))
    return next((i for i, (name, output) in named if is_it(name.lower(), output)), None)


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


def _require(condition: bool, probe: Probe) -> None:
    if not condition:
        raise _unknown(probe)


def _unknown(probe: Probe) -> ModelError:
    width, height = probe.size_wh
    names = '' if probe.num_classes is None else f' and {probe.num_classes} class names'
    task = f', task {probe.metadata["task"]}' if 'task' in probe.metadata else ''
    return ModelError(
        f'output of no known detector: {probe} at input {width}x{height}{names}{task}; '
        f'export a plain detection model, or name its form with the parameter "layout"'
    )
