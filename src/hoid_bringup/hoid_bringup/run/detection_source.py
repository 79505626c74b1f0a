"""The detections of an offline run: from the detector, or ground-truth boxes."""

from __future__ import annotations

import logging
from collections.abc import Callable

from hoid_bags.sequence import Sequence
from hoid_bringup.run.run_config import NO_TRUTH, TRUTH, RunConfig
from hoid_common.errors import InputError
from hoid_common.sync import Rate
from hoid_common.values import Detections, RgbdFrame
from hoid_detector.model.model_path import find_model
from hoid_detector.onnx_detector import OnnxDetector

_LOG = logging.getLogger(__name__)

DetectionSource = Callable[[RgbdFrame], Detections | None]


def detection_source(
    sequence: Sequence,
    config: RunConfig,
    expected: Callable[[], Detections | None] = lambda: None,
) -> DetectionSource:
    """Return a function that returns the detections of a frame, or None.

    None: the strategy needs no detections, the detector skips the frame by its rate, or the frame
    has no message with ground-truth boxes. InputError if ground-truth boxes are requested, but the
    recording has none. ModelError if the detector model is not found, or cannot be used.

    Args:
        expected: Function that returns where the object map expects objects; a detector uses it
            with `detector.expected_score_threshold`.
    """
    if not config.needs_detections:
        return lambda _frame: None
    if config.detector.model == TRUTH:
        exact = sequence.true_detections
        if exact is None:
            raise InputError(f'{sequence.name}: {NO_TRUTH}')
        return _at_rate(lambda frame: exact.get(frame.stamp_ns), config.detector.rate_hz)
    detector = OnnxDetector(find_model(config.detector.model or None), config.detector)
    if warning := detector.network.provider_warning:
        _LOG.warning('%s', warning)

    def detect(frame: RgbdFrame) -> Detections:
        detector.expected = expected()
        return detector.detect(frame.image_bgr, frame.stamp_ns)

    return _at_rate(detect, config.detector.rate_hz)


def _at_rate(detect: DetectionSource, rate_hz: float) -> DetectionSource:
    """Return a source that detects objects at a rate, by stamps of frames; None for the others."""
    rate = Rate(rate_hz)
    return lambda frame: detect(frame) if rate.take_due(frame.stamp_ns) else None
