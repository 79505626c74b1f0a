"""Time per frame of one stage on a recording: median and 95th percentile."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2
import numpy as np

from hoid_bags.sequence import Sequence, open_sequence
from hoid_benchmarks.plan.sequences import Store
from hoid_bringup.run.offline import OfflinePipeline
from hoid_bringup.run.provenance import machine
from hoid_bringup.run.run_config import RunConfig
from hoid_common.errors import InputError
from hoid_common.values import S_PER_NS, Detections, RgbdFrame
from hoid_detector.model.model_path import find_model
from hoid_detector.onnx_detector import OnnxDetector
from hoid_filter.config import FilterConfig
from hoid_filter.feature_filter import FeatureFilter

_RECORDINGS = ('fr1_xyz', 'synth-1')  # the first one that is available
_FRAMES = 300
_BOXES = 20
_STRATEGIES = ('none', 'person', 'hoid2d', 'hoid3d', 'descriptor', 'motion', 'hoid+')


def time_stage(stage: str, store: Store) -> str:
    """Return a table of a stage's times in ms.

    Raises:
        InputError: No recording is available, and none can be rendered.
    """
    sequence = _recording(store)
    rows = STAGES[stage](sequence)
    lines = [f'{sequence.name}, {machine()}', f'{"":24}{"median ms":>10}{"p95 ms":>10}']
    for name, times_ms in rows:
        median, p95 = np.percentile(times_ms, (50, 95))
        lines.append(f'{name:24}{median:10.2f}{p95:10.2f}')
    return '\n'.join(lines) + '\n'


Rows = Iterator[tuple[str, list[float]]]


def _recording(store: Store) -> Sequence:
    for name in _RECORDINGS:
        try:
            return open_sequence(store.find(name))
        except InputError:  # tried in order; the last one can always be rendered
            continue
    raise InputError(f'none of {", ".join(_RECORDINGS)} is available or can be rendered')


def _time_track(sequence: Sequence) -> Rows:
    """Yield the durations of every stage of a run without a filter."""
    config = RunConfig().updated({'filter.strategy': 'none'})
    pipeline = OfflinePipeline(sequence, config)
    for frame in sequence:
        pipeline.process(frame)
    yield from pipeline.stage_ms.items()


def _time_filter(sequence: Sequence) -> Rows:
    """Yield the durations of the extraction, and of each strategy alone."""
    cv2.setNumThreads(1)  # a robot has other work for the other cores
    for strategy in _STRATEGIES:
        config = replace(FilterConfig(), strategy=strategy)
        stage = FeatureFilter(config, sequence.camera)
        results = [stage.process(frame, _crowd(frame)).stage_ms for frame in _first(sequence)]
        if strategy == _STRATEGIES[0]:
            yield 'extraction', [ms['extract'] for ms in results]
        yield strategy, [ms['filter'] for ms in results]


def _time_detect(sequence: Sequence) -> Rows:
    """Yield the wall times of the default detector, whose network runs in several threads."""
    from hoid_common.ros import conversions  # noqa: PLC0415  the other stages need no ROS

    path = find_model(None)
    detector = OnnxDetector(path, RunConfig().detector)
    names, size_px = detector.class_names, (sequence.camera.width_px, sequence.camera.height_px)
    total_ms, network_ms = [], []
    for frame in _first(sequence):
        start_s = time.perf_counter()
        found = detector.detect(frame.image_bgr, frame.stamp_ns)
        header = conversions.header_to_msg(frame.stamp_ns, '')
        conversions.detections_to_msg(found, header, size_px, names)
        total_ms.append(1e3 * (time.perf_counter() - start_s))
        network_ms.append(detector.network_ms)
    yield f'{path.stem} network', network_ms
    yield 'letterbox to message', [a - b for a, b in zip(total_ms, network_ms, strict=True)]
    yield f'{path.stem} in all', total_ms


def _first(sequence: Sequence) -> Iterator[RgbdFrame]:
    return (frame for frame, _ in zip(sequence, range(_FRAMES), strict=False))


def _crowd(frame: RgbdFrame) -> Detections:
    """Return 20 moving boxes, a few of people and the others of cups."""
    rng = np.random.default_rng(0)
    size = rng.uniform(20, 90, (_BOXES, 2))
    phase = rng.uniform(0, 2 * np.pi, (_BOXES, 2)) + frame.stamp_ns * S_PER_NS
    corner = (0.5 + 0.5 * np.sin(phase)) * (500, 380)
    names = tuple('person' if i % 5 == 0 else 'cup' for i in range(_BOXES))
    boxes = np.concatenate([corner, corner + size], 1).astype(np.float32)
    return Detections(frame.stamp_ns, boxes, names, np.full(_BOXES, 0.8, np.float32))


STAGES: dict[str, Callable[[Sequence], Rows]] = {
    'track': _time_track,
    'filter': _time_filter,
    'detect': _time_detect,
}
"""Stages that `hoid bench` can time."""
