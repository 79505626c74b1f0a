"""Detector: finds boxes with class and score in images with an ONNX model."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import ConfigError, MessageError, ModelError
from hoid_common.values import BoolArray, ByteArray, Detections, IntArray
from hoid_detector.config import DetectorConfig
from hoid_detector.model.class_names import COCO, known_names
from hoid_detector.model.decoders import Candidates, Size
from hoid_detector.model.layouts import AUTO, Layout, Preprocessing, Probe, recognize
from hoid_detector.model.letterbox import Letterbox, Placement, open_size
from hoid_detector.model.network import Network
from hoid_detector.model.nms import nms

_LOG = logging.getLogger(__name__)


class OnnxDetector:
    """Detector with any ONNX model of the YOLO family; the output layout follows from the model.

    The caller reports `network.provider_warning` where it is not empty.

    Raises:
        ModelError: The model cannot be read, its outputs are not finite, its layout is unknown,
            or it does not name its classes.
        ConfigError: `classes` or `providers` names something unknown.
    """

    def __init__(self, model: Path, config: DetectorConfig) -> None:
        self.network = Network(model, config.providers, config.threads)
        self.layout, self.class_names = _layout_and_class_names(self.network, config)
        self._letterbox = Letterbox(self.layout.preprocessing, self.network.dtype)
        self.reconfigure(config)
        self.has_finite_outputs = True  # for the latest image
        self.num_non_finite = 0  # images for which the outputs were not finite
        self.network_ms = 0.0  # inference of the latest image, wall time
        self.detect_ms = 0.0  # all of the latest call of `detect`, wall time
        _LOG.info('%s', self.description)

    @property
    def config(self) -> DetectorConfig:
        """Return the current configuration."""
        return self._config

    @property
    def description(self) -> str:
        """Return the model, its layout, classes, input format and execution provider in a line."""
        network = self.network
        size = 'x'.join(map(str, network.size_wh)) if network.size_wh else 'any size'
        return (
            f'{network.path.name}: {self.layout.name}, {len(self.class_names)} classes, input '
            f'{size} {np.dtype(network.dtype).name} {self.layout.preprocessing}, '
            f'on {network.provider}'
        )

    def reconfigure(self, config: DetectorConfig) -> None:
        """Apply the parameters that may change while the node runs."""
        self.check_classes(config.classes)
        names = np.array(self.class_names)
        self._reported = np.isin(names, config.classes) if config.classes else None
        self._config = config

    def check_classes(self, classes: tuple[str, ...]) -> None:
        """Raise ConfigError if the model lacks one of the classes."""
        for name in classes:
            if name not in self.class_names:
                known = ', '.join(self.class_names)
                raise ConfigError(f'classes: the model knows no "{name}"; it knows {known}')

    def detect(self, image_bgr: ByteArray, stamp_ns: int) -> Detections:
        """Return the detections in an image (H, W, 3), highest score first, clipped to the image.

        It must not be called by two threads at the same time.
        """
        if image_bgr.ndim != 3 or image_bgr.shape[2] != 3 or 0 in image_bgr.shape:
            raise MessageError(f'image must be (height, width, 3), got {image_bgr.shape}')
        start_s = time.perf_counter()
        config = self._config
        size_wh = _input_size(self.network, image_bgr.shape[1::-1], config)
        blob, place = self._letterbox(image_bgr, size_wh)
        outputs = self._infer(blob)
        with np.errstate(over='ignore', invalid='ignore'):  # non-finite boxes are dropped below
            found = self.layout.decode(outputs, size_wh, config.score_threshold)
        finite = _is_finite(found)
        self._count_non_finite(outputs, has_candidates=bool(finite.any()))
        found = _in_image(found.select(finite & self._is_reported(found)), place)
        found = found.select(_strongest(found, self.layout, config))
        self.detect_ms = (time.perf_counter() - start_s) * 1e3
        return self._named(found, stamp_ns)

    def _count_non_finite(self, outputs: Sequence[NDArray[Any]], *, has_candidates: bool) -> None:
        """Count images with non-finite outputs only, and warn at the first of them."""
        self.has_finite_outputs = has_candidates or _are_finite(outputs)
        if not self.has_finite_outputs:
            self.num_non_finite += 1
            if self.num_non_finite == 1:
                _LOG.warning('%s', self.non_finite_warning)

    @property
    def non_finite_warning(self) -> str:
        """Return the warning that applies while `has_finite_outputs` is False."""
        return f'{self.network.path}: all outputs are NaN or Inf, so nothing is detected'

    def _infer(self, blob: NDArray[np.floating[Any]]) -> list[NDArray[Any]]:
        start_s = time.perf_counter()
        outputs = self.network.run(blob)
        self.network_ms = (time.perf_counter() - start_s) * 1e3
        return outputs

    def _is_reported(self, found: Candidates) -> BoolArray:
        if self._reported is None:
            return np.ones(len(found.scores), np.bool_)
        known = found.class_ids < len(self._reported)
        return known & self._reported[np.where(known, found.class_ids, 0)]

    def _named(self, found: Candidates, stamp_ns: int) -> Detections:
        names = self.class_names
        return Detections(
            stamp_ns,
            found.boxes_xyxy_px,
            tuple(names[i] if i < len(names) else f'class {i}' for i in found.class_ids.tolist()),
            np.clip(found.scores, 0, 1),
        )


def _layout_and_class_names(
    network: Network, config: DetectorConfig
) -> tuple[Layout, tuple[str, ...]]:
    """Run the network once on noise, which also warms it up, to recognize its layout."""
    names = known_names(config.class_names_file, network.metadata)
    size_wh = _input_size(network, (640, 480), config)
    noise = np.random.default_rng(0).integers(0, 256, (size_wh[1], size_wh[0], 3), np.uint8)
    blob, _ = Letterbox(Preprocessing(True, True, 'stretch'), network.dtype)(noise, size_wh)
    outputs = tuple(network.run(blob))
    if not _are_finite(outputs):
        raise ModelError(f'{network.path}: all outputs are NaN or Inf; export the model again')
    num_names = len(names) if names else None
    probe = Probe(
        size_wh, network.output_names, outputs, network.metadata, num_names, config.box_units
    )
    try:
        layout = recognize(probe, config.layout)
    except ModelError as error:
        raise ModelError(f'{network.path}: {error}') from error
    if names is None and layout.num_classes not in (None, len(COCO)):
        raise ModelError(
            f'{network.path}: has {layout.num_classes} classes and does not name them: '
            'set class_names_file'
        )
    preprocessing = _overridden(layout.preprocessing, config)
    return layout._replace(preprocessing=preprocessing), COCO if names is None else names


def _overridden(preprocessing: Preprocessing, config: DetectorConfig) -> Preprocessing:
    """Return the preprocessing with the values of those parameters that are not `auto`."""
    if config.color_order != AUTO:
        preprocessing = preprocessing._replace(rgb=config.color_order == 'rgb')
    if config.value_range != AUTO:
        preprocessing = preprocessing._replace(unit_range=config.value_range == 'unit')
    if config.letterbox != AUTO:
        preprocessing = preprocessing._replace(placement=config.letterbox)
    return preprocessing


def _input_size(network: Network, image_wh: Size, config: DetectorConfig) -> Size:
    return network.size_wh or open_size(image_wh, config.input_size_px)


def _are_finite(outputs: Sequence[NDArray[Any]]) -> bool:
    """Return whether every output is empty or has a finite number."""
    return all(output.size == 0 or bool(np.isfinite(output).any()) for output in outputs)


def _is_finite(found: Candidates) -> BoolArray:
    """Return the (N,) mask of candidates with finite numbers and a valid class."""
    finite = np.isfinite(found.boxes_xyxy_px).all(axis=1) & np.isfinite(found.scores)
    return finite & (found.class_ids >= 0)


def _in_image(found: Candidates, place: Placement) -> Candidates:
    """Return the candidates in image pixels, without those of less than a pixel in the image."""
    boxes = place.boxes_to_image(found.boxes_xyxy_px)
    is_visible = np.all(boxes[:, 2:] - boxes[:, :2] >= 1, axis=1)
    return found._replace(boxes_xyxy_px=boxes).select(is_visible)


def _strongest(found: Candidates, layout: Layout, config: DetectorConfig) -> IntArray:
    if layout.needs_nms:
        return nms(*found, config.nms_iou)[: config.max_detections]
    return np.argsort(-found.scores, kind='stable')[: config.max_detections]
