"""The detector: an image goes in, boxes with class and score come out."""

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
from hoid_detector.model.layouts import Layout, Probe, recognize
from hoid_detector.model.letterbox import Letterbox, Placement, Preprocessing, open_size
from hoid_detector.model.network import Network
from hoid_detector.model.nms import nms

_LOG = logging.getLogger(__name__)


class OnnxDetector:
    """Any ONNX model of the YOLO family, its output layout told from the file.

    Whoever makes one says `network.provider_warning`, where there is one, in its own way.

    Raises:
        ModelError: the model cannot be read, gives no numbers, is no known detector, or does not
            name its classes.
        ConfigError: `classes` or `providers` names what does not exist.
    """

    def __init__(self, model: Path, config: DetectorConfig) -> None:
        self.network = Network(model, config.providers, config.threads)
        self.layout, self.class_names = _understood(self.network, config)
        self._letterbox = Letterbox(self.layout.preprocessing, self.network.dtype)
        self.reconfigure(config)
        self.gives_numbers = True  # for the latest image
        self.num_without_numbers = 0  # images for which it gave none
        self.network_ms = 0.0  # of the latest call, wall time
        self.detect_ms = 0.0  # of the latest call, wall time, the network's included
        _LOG.info('%s', self.description)

    @property
    def config(self) -> DetectorConfig:
        """Return the configuration in force."""
        return self._config

    @property
    def description(self) -> str:
        """Return in one line which model runs, how it is fed and where."""
        network = self.network
        size = 'x'.join(map(str, network.size_wh)) if network.size_wh else 'any size'
        return (
            f'{network.path.name}: {self.layout.name}, {len(self.class_names)} classes, input '
            f'{size} {np.dtype(network.dtype).name} {self.layout.preprocessing}, '
            f'on {network.provider}'
        )

    def reconfigure(self, config: DetectorConfig) -> None:
        """Take over what may change at run time: thresholds, classes, number of boxes."""
        if objection := self.objection(config.classes):
            raise ConfigError(objection)
        names = np.array(self.class_names)
        self._reported = np.isin(names, config.classes) if config.classes else None
        self._config = config

    def objection(self, classes: tuple[str, ...]) -> str:
        """Return why these cannot be the classes to report, or nothing."""
        unknown = [name for name in classes if name not in self.class_names]
        known = ', '.join(self.class_names)
        return f'classes: the model knows no "{unknown[0]}"; it knows {known}' if unknown else ''

    def detect(self, image_bgr: ByteArray, stamp_ns: int) -> Detections:
        """Return what is seen in an image (H, W, 3), strongest first; boxes lie within the image.

        Not to be called by two threads at a time.
        """
        if image_bgr.ndim != 3 or image_bgr.shape[2] != 3 or 0 in image_bgr.shape:
            raise MessageError(f'image must be (height, width, 3), got {image_bgr.shape}')
        start_s = time.perf_counter()
        config = self._config
        size_wh = _input_size(self.network, image_bgr.shape[1::-1], config)
        blob, place = self._letterbox(image_bgr, size_wh)
        outputs = self._infer(blob)
        with np.errstate(over='ignore', invalid='ignore'):  # what is not finite is dropped
            found = self.layout.decode(outputs, size_wh, config.score_threshold)
        finite = _is_finite(found)
        self._note_numbers(outputs, is_sound=bool(finite.any()))
        found = _in_image(found.select(finite & self._is_reported(found)), place)
        found = found.select(_strongest(found, self.layout, config))
        self.detect_ms = (time.perf_counter() - start_s) * 1e3
        return self._named(found, stamp_ns)

    def _note_numbers(self, outputs: Sequence[NDArray[Any]], *, is_sound: bool) -> None:
        """Count images of which the network gives no number, and say so at the first."""
        self.gives_numbers = is_sound or _has_numbers(outputs)
        if not self.gives_numbers:
            self.num_without_numbers += 1
            if self.num_without_numbers == 1:
                _LOG.warning('%s', self.nonsense)

    @property
    def nonsense(self) -> str:
        """Return what is to be said while `gives_numbers` is False."""
        return f'{self.network.path}: gives only NaN or Inf, so nothing is detected'

    def _infer(self, blob: NDArray[np.floating[Any]]) -> list[NDArray[Any]]:
        start_s = time.perf_counter()
        outputs = self.network.run(blob)
        self.network_ms = (time.perf_counter() - start_s) * 1e3
        return outputs

    def _is_reported(self, found: Candidates) -> BoolArray:
        if self._reported is None:  # all classes
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


def _understood(network: Network, config: DetectorConfig) -> tuple[Layout, tuple[str, ...]]:
    """Run the network once on noise, which warms it up too; return layout and class names."""
    names = known_names(config.class_names_file, network.metadata)
    size_wh = _input_size(network, (640, 480), config)
    noise = np.random.default_rng(0).integers(0, 256, (size_wh[1], size_wh[0], 3), np.uint8)
    blob, _ = Letterbox(
        Preprocessing(rgb=True, unit_range=True, placement='stretch'), network.dtype
    )(noise, size_wh)
    outputs = tuple(network.run(blob))
    if not _has_numbers(outputs):
        raise ModelError(f'{network.path}: gives only NaN or Inf; export the model again')
    num_names = len(names) if names else None
    try:
        layout = recognize(
            Probe(size_wh, network.output_names, outputs, network.metadata, num_names), config
        )
    except ModelError as error:
        raise ModelError(f'{network.path}: {error}') from error
    if names is None:
        if layout.num_classes not in (None, len(COCO)):
            raise ModelError(
                f'{network.path} has {layout.num_classes} classes and does not name them: '
                f'give class_names_file'
            )
        names = COCO
    return layout, names


def _input_size(network: Network, image_wh: Size, config: DetectorConfig) -> Size:
    return network.size_wh or open_size(image_wh, config.input_size_px)


def _has_numbers(outputs: Sequence[NDArray[Any]]) -> bool:
    """Return whether every output has a finite number, or none was to be expected."""
    return all(output.size == 0 or bool(np.isfinite(output).any()) for output in outputs)


def _is_finite(found: Candidates) -> BoolArray:
    """Return which candidates are finite and of a class, (N,)."""
    finite = np.isfinite(found.boxes_xyxy_px).all(axis=1) & np.isfinite(found.scores)
    return finite & (found.class_ids >= 0)


def _in_image(found: Candidates, place: Placement) -> Candidates:
    """Return those that show at least a pixel of the image, in its pixels."""
    boxes = place.boxes_to_image(found.boxes_xyxy_px)
    shown = np.all(boxes[:, 2:] - boxes[:, :2] >= 1, axis=1)
    return found._replace(boxes_xyxy_px=boxes).select(shown)


def _strongest(found: Candidates, layout: Layout, config: DetectorConfig) -> IntArray:
    if layout.needs_nms:
        return nms(*found, config.nms_iou)[: config.max_detections]
    return np.argsort(-found.scores, kind='stable')[: config.max_detections]
