"""The detector: finds boxes with class and score in color images by an ONNX model."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoid_common.coco import COCO
from hoid_common.errors import ConfigError, MessageError, ModelError, prefixed
from hoid_common.values import BoolArray, ByteArray, Detections, Float32Array, IntArray
from hoid_detector.config import DetectorConfig
from hoid_detector.expected_objects import confirmed_rows
from hoid_detector.model.class_names import known_names, with_person
from hoid_detector.model.decoders import Candidates, Size, nms
from hoid_detector.model.finished_boxes import MAX_SCORE
from hoid_detector.model.layouts import Layout, recognize
from hoid_detector.model.letterbox import Letterbox, Placement, Preprocessing, open_size
from hoid_detector.model.network import Network
from hoid_detector.model.probe import AUTO, Probe
from hoid_detector.quarter_turn import boxes_before_turn, nearest_quarter, turned

_LOG = logging.getLogger(__name__)
# Chosen: the layout is wrong if at least this many boxes, and most of all boxes, are outside the
# image.
_MIN_OUTSIDE = 3
# Chosen: a warning is logged if this many images at the start have no box; 10 s at 30 Hz.
_MANY_EMPTY = 300
_MAX_DETECTIONS = 100  # chosen: more people and objects than fit into a view


class OnnxDetector:
    """Detector with an ONNX model, whose output layout is recognized by running it on noise.

    The constructor raises ModelError if the model cannot be used, and ConfigError for unknown
    classes or providers.
    """

    def __init__(self, model: Path, config: DetectorConfig) -> None:
        self.network = Network(model, config.providers, config.threads)
        self.layout, self.class_names = _layout_and_class_names(self.network, config)
        self._letterbox = Letterbox(self.layout.preprocessing, self.network.dtype)
        self.reconfigure(config)
        self.warning = ''  # one line if the outputs for the latest image are not finite
        self._num_inside = self._num_outside = 0  # numbers of boxes in all images so far
        # Number of images without a box so far; None: an image had a box.
        self._num_empty: int | None = 0
        self.num_non_finite = 0  # number of images whose outputs were not finite
        self.network_ms = 0.0  # wall time of the inference of the latest image
        self.detect_ms = 0.0  # wall time of the latest call of `detect`
        # Boxes in which images of about this time should show known objects, or None. They have an
        # effect only with `expected_score_threshold`. Any thread may set them.
        self.expected: Detections | None = None
        _LOG.info('%s', self.description)

    @property
    def description(self) -> str:
        network = self.network
        size = 'x'.join(map(str, network.size_wh)) if network.size_wh else 'any size'
        return (
            f'{network.path.name}: {self.layout.name}, {len(self.class_names)} classes, input '
            f'{size} {np.dtype(network.dtype).name} {self.layout.preprocessing}, '
            f'on {network.provider}'
        )

    def reconfigure(self, config: DetectorConfig) -> None:
        """Apply new parameters, but keep the loaded model; ConfigError for an unknown class."""
        self.check_classes(config.classes)
        names = np.array(self.class_names)
        self._is_reported = np.isin(names, config.classes or names)
        self.config = config

    def check_classes(self, classes: tuple[str, ...]) -> None:
        for name in classes:
            if name not in self.class_names:
                known = ', '.join(self.class_names)
                raise ConfigError(f'classes: the model knows no "{name}"; it knows {known}')

    def detect(self, image_bgr: ByteArray, stamp_ns: int) -> Detections:
        """Return the detections in an image (H, W, 3), highest score first, clipped to the image.

        MessageError for another shape; ModelError if the outputs do not fit the layout, or most
        boxes so far were outside their images. It is not thread-safe.
        """
        if image_bgr.ndim != 3 or image_bgr.shape[2] != 3 or 0 in image_bgr.shape:
            raise MessageError(f'image must be (height, width, 3), got {image_bgr.shape}')
        start_s = time.perf_counter()
        config = self.config
        quarters = nearest_quarter(config.camera_roll_deg)
        upright = turned(image_bgr, quarters)
        size_wh = _input_size(self.network, upright.shape[1::-1], config)
        blob, place = self._letterbox(upright, size_wh)
        outputs = self._infer(blob)
        with np.errstate(over='ignore', invalid='ignore'):  # non-finite boxes are dropped below
            found, weak = self._decode(outputs, size_wh)
        finite = _is_finite(found)
        self._count_non_finite(outputs, has_candidates=bool(finite.any()))
        found = found.select(finite)
        self._report_silence(has_boxes=len(found.scores) > 0)
        self._check_positions(place.boxes_to_image(found.boxes_xyxy_px, clip=False), place)
        found = self._visible(found, place)
        found = found.select(_strongest(found, self.layout, config))
        found = _turned_back(found, quarters, image_bgr)
        if self.expected is not None:
            weak = self._visible(weak.select(_is_finite(weak)), place)
            weak = _turned_back(weak, quarters, image_bgr)
            strong = self._with_names(found, stamp_ns)
            rows = confirmed_rows(self._with_names(weak, stamp_ns), strong, self.expected)
            found = _joined(found, weak.select(rows))
        self.detect_ms = (time.perf_counter() - start_s) * 1e3
        return self._with_names(found, stamp_ns)

    def _decode(
        self, outputs: Sequence[NDArray[Any]], size_wh: Size
    ) -> tuple[Candidates, Candidates]:
        """Return candidates that reach `score_threshold`, and weaker ones if they are used."""
        with prefixed(f'{self.network.path}: ', ModelError, ModelError):
            least, weakest = self.config.score_threshold, self.config.expected_score_threshold
            found = self.layout.decode(outputs, size_wh, min(least, weakest or least))
            highest = float(np.nanmax(found.scores, initial=0))
            if MAX_SCORE < highest < np.inf:
                raise ModelError(
                    f'the answer has a score of {highest:g}, but scores are at most 1; set the '
                    f'parameter "layout", now {self.layout.name}, or export the model again'
                )
        is_weak = found.scores < least
        return found.select(~is_weak), found.select(is_weak)

    def _check_positions(self, boxes_xyxy_px: Float32Array, place: Placement) -> None:
        """Raise ModelError if most boxes so far, and at least three, are outside the image."""
        center = (boxes_xyxy_px[:, :2] + boxes_xyxy_px[:, 2:]) / 2
        size_px = (place.image_width_px, place.image_height_px)
        inside = ((center >= 0) & (center <= size_px)).all(axis=1)
        self._num_inside += int(inside.sum())
        self._num_outside += int((~inside).sum())
        if self._num_outside >= max(_MIN_OUTSIDE, self._num_inside + 1):
            raise ModelError(
                f'{self.network.path}: {self._num_outside} boxes are outside the image and '
                f'{self._num_inside} inside, the last at {_text(boxes_xyxy_px[~inside][-1:])}; '
                f'set the parameter "layout", now {self.layout.name}'
            )

    def _report_silence(self, *, has_boxes: bool) -> None:
        """Warn once if none of the first 300 images had a box, as with a wrong input format."""
        if has_boxes or self._num_empty is None:
            self._num_empty = None
            return
        self._num_empty += 1
        if self._num_empty == _MANY_EMPTY:
            _LOG.warning(
                '%s: nothing is detected in the first %d images; if people or objects were in '
                'view, set the parameters "value_range", "color_order" or "letterbox", now %s',
                self.network.path, _MANY_EMPTY, self.layout.preprocessing,
            )  # fmt: skip

    def _count_non_finite(self, outputs: Sequence[NDArray[Any]], *, has_candidates: bool) -> None:
        self.warning = ''
        if not has_candidates and not _are_finite(outputs):
            self.warning = f'{self.network.path}: all outputs are NaN or Inf: nothing is detected'
            self.num_non_finite += 1
            if self.num_non_finite == 1:
                _LOG.warning('%s', self.warning)

    def _infer(self, blob: NDArray[np.number[Any]]) -> list[NDArray[Any]]:
        start_s = time.perf_counter()
        outputs = self.network.run(blob)
        self.network_ms = (time.perf_counter() - start_s) * 1e3
        return outputs

    def _visible(self, found: Candidates, place: Placement) -> Candidates:
        """Return the candidates of reported classes, in image pixels, clipped, not too thin."""
        found = found.select(self._is_reported[found.class_ids])
        boxes = place.boxes_to_image(found.boxes_xyxy_px)
        is_visible = np.all(boxes[:, 2:] - boxes[:, :2] >= 1, axis=1)
        return found._replace(boxes_xyxy_px=boxes).select(is_visible)

    def _with_names(self, found: Candidates, stamp_ns: int) -> Detections:
        return Detections(
            stamp_ns,
            found.boxes_xyxy_px,
            tuple(self.class_names[i] for i in found.class_ids.tolist()),
            np.clip(found.scores, 0, 1),
        )


def _layout_and_class_names(
    network: Network, config: DetectorConfig
) -> tuple[Layout, tuple[str, ...]]:
    names = known_names(config.class_names_file, network.metadata)
    size_wh = _input_size(network, (640, 480), config)
    noise = np.random.default_rng(0).integers(0, 256, (size_wh[1], size_wh[0], 3), np.uint8)
    blob, _ = Letterbox(Preprocessing(True, 'unit', 'stretch'), network.dtype)(noise, size_wh)
    outputs = tuple(network.run(blob))
    if not _are_finite(outputs):
        raise ModelError(f'{network.path}: all outputs are NaN or Inf; export the model again')
    probe = Probe(
        size_wh, network.output_names, outputs, network.metadata, names,
        config.class_ids, network.takes_size,
    )  # fmt: skip
    with prefixed(f'{network.path}: ', ModelError, ModelError):
        layout = recognize(probe, config.layout)
        if names is None and layout.num_classes not in (None, len(COCO)):
            raise ModelError(
                f'has {layout.num_classes} classes and does not name them: set class_names_file'
            )
        names = with_person(COCO if names is None else names, config.person_names)
    return layout._replace(preprocessing=_overridden(layout.preprocessing, config)), names


def _overridden(preprocessing: Preprocessing, config: DetectorConfig) -> Preprocessing:
    if config.color_order != AUTO:
        preprocessing = preprocessing._replace(rgb=config.color_order == 'rgb')
    if config.value_range != AUTO:
        preprocessing = preprocessing._replace(value_range=config.value_range)
    if config.letterbox != AUTO:
        preprocessing = preprocessing._replace(placement=config.letterbox)
    return preprocessing


def _input_size(network: Network, image_wh: Size, config: DetectorConfig) -> Size:
    return network.size_wh or open_size(image_wh, config.input_size_px)


def _are_finite(outputs: Sequence[NDArray[Any]]) -> bool:
    return all(output.size == 0 or bool(np.isfinite(output).any()) for output in outputs)


def _is_finite(found: Candidates) -> BoolArray:
    finite = np.isfinite(found.boxes_xyxy_px).all(axis=1) & np.isfinite(found.scores)
    return finite & (found.class_ids >= 0)


def _turned_back(found: Candidates, quarters: int, image: ByteArray) -> Candidates:
    boxes = boxes_before_turn(found.boxes_xyxy_px, quarters, image.shape[1::-1])
    return found._replace(boxes_xyxy_px=boxes)


def _joined(strong: Candidates, weak: Candidates) -> Candidates:
    weak = weak.select(np.argsort(-weak.scores, kind='stable'))
    both = Candidates(
        np.concatenate([strong.boxes_xyxy_px, weak.boxes_xyxy_px]),
        np.concatenate([strong.scores, weak.scores]),
        np.concatenate([strong.class_ids, weak.class_ids]),
    )
    return both.select(np.arange(min(len(both.scores), _MAX_DETECTIONS)))


def _text(boxes: Float32Array) -> str:
    return ' '.join(f'{value:.0f}' for value in boxes.ravel())


def _strongest(found: Candidates, layout: Layout, config: DetectorConfig) -> IntArray:
    if layout.needs_nms:
        return nms(*found, config.nms_iou)[:_MAX_DETECTIONS]
    return np.argsort(-found.scores, kind='stable')[:_MAX_DETECTIONS]
