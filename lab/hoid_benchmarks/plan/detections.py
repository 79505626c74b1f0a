"""Cache of detections, by recording, model and image.

A detector is deterministic, and repeating it would take most of an experiment's time. Timed runs
do not use the cache.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from hoid_bags.sequence import Sequence
from hoid_bringup.run.detection_source import DetectionSource, detection_source
from hoid_bringup.run.run_config import TRUTH, RunConfig
from hoid_common.values import Detections, RgbdFrame
from hoid_detector.model.model_path import find_model

_DIGEST_BYTES = 16


class DetectionCache:
    """A detector that runs once for each distinct image of a recording.

    Images are identified by their pixels, because a perturbed image has the stamp of another one.
    """

    def __init__(self, path: Path, detect: DetectionSource) -> None:
        self._path = path
        self._detect = detect
        self._known = _read(path) if path.is_file() else {}
        self._num_read = len(self._known)

    def __call__(self, frame: RgbdFrame) -> Detections | None:
        """Return the detections of an image, from the cache if possible."""
        image = _digest(frame)
        if image not in self._known:
            found = self._detect(frame)
            if found is None:
                return None
            self._known[image] = found
        return replace(self._known[image], stamp_ns=frame.stamp_ns)

    def save(self) -> None:
        """Write new detections to the file. If two runs do so at once, the last one wins."""
        if len(self._known) == self._num_read:
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = self._path.with_suffix(f'.{os.getpid()}.npz')
        _write(unfinished, self._known)
        unfinished.replace(self._path)


def cached_detections(
    sequence: Sequence, config: RunConfig, folder: Path
) -> DetectionCache | None:
    """Return the cached detector of a recording; None if no detector is needed.

    Raises:
        ModelError: There is no such model.
    """
    if not config.needs_detections or config.detector.model == TRUTH:
        return None
    config = every_image(config)
    model = find_model(config.detector.model or None)
    identity = model.read_bytes() + repr(config.detector).encode()
    name = f'{sequence.name}-{model.stem}-{hashlib.sha256(identity).hexdigest()[:8]}.npz'
    return DetectionCache(folder / name, detection_source(sequence, config))


def every_image(config: RunConfig) -> RunConfig:
    """Return a configuration in which objects are detected in every image."""
    return config.updated({'detector.rate_hz': 0.0})


def _digest(frame: RgbdFrame) -> bytes:
    return hashlib.blake2b(frame.image_bgr.tobytes(), digest_size=_DIGEST_BYTES).digest()


def _write(path: Path, known: dict[bytes, Detections]) -> None:
    found = list(known.values())
    np.savez(
        path,
        images=np.frombuffer(b''.join(known), np.uint8).reshape(-1, _DIGEST_BYTES),
        counts=np.array([len(d) for d in found], np.int64),
        boxes_xyxy_px=np.concatenate([d.boxes_xyxy_px for d in found]),
        scores=np.concatenate([d.scores for d in found]),
        names=np.array([name for d in found for name in d.class_names], np.str_),
    )


def _read(path: Path) -> dict[bytes, Detections]:
    with np.load(path) as saved:
        ends = np.cumsum(saved['counts'])[:-1]
        boxes, scores, names = (
            np.split(saved[k], ends) for k in ('boxes_xyxy_px', 'scores', 'names')
        )
        images = [image.tobytes() for image in saved['images']]
    return {
        image: Detections(0, boxes[i], tuple(names[i].tolist()), scores[i])
        for i, image in enumerate(images)
    }
