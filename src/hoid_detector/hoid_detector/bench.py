"""How long detection takes, and how much of it is not the network."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from hoid_common.values import ByteArray
from hoid_detector.onnx_detector import OnnxDetector


class DetectionTime(NamedTuple):
    """Time per image, in ms."""

    detect_median_ms: float  # wall
    detect_p95_ms: float
    network_median_ms: float  # wall, within the above
    overhead_median_ms: float  # wall of letterbox, decoding and suppression: detect - network
    overhead_p95_ms: float
    cpu_median_ms: float  # of all threads of the process
    num_images: int


def time_detection(
    detector: OnnxDetector, images: list[ByteArray], repeats: int = 1
) -> DetectionTime:
    """Return times over all images (H, W, 3), after one unmeasured call."""
    detector.detect(images[0], 0)
    wall, network, cpu = [], [], []
    for image in images * repeats:
        start_cpu_s = time.process_time()
        detector.detect(image, 0)
        cpu.append((time.process_time() - start_cpu_s) * 1e3)
        wall.append(detector.detect_ms)
        network.append(detector.network_ms)
    overhead = np.array(wall) - np.array(network)
    return DetectionTime(
        detect_median_ms=float(np.median(wall)),
        detect_p95_ms=float(np.percentile(wall, 95)),
        network_median_ms=float(np.median(network)),
        overhead_median_ms=float(np.median(overhead)),
        overhead_p95_ms=float(np.percentile(overhead, 95)),
        cpu_median_ms=float(np.median(cpu)),
        num_images=len(wall),
    )
