"""Recordings as drivers leave them: read as they are or refused; wrong readings are noticed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hoid_benchmarks.faults import recordings
from hoid_benchmarks.faults.recordings import SILENT
from hoid_common.values import CameraModel

OTHER = CameraModel(160, 120, 149.0, 151.0, 79.5, 59.5)
SAMPLES: Any = None  # which these kinds do not use
KINDS = (
    recordings.repeated_stamps,
    recordings.offset_stamps,
    recordings.empty_frame_id,
    recordings.depth_units,
    recordings.extreme_depths,
    recordings.rectified_images,
    recordings.changed_camera,
    recordings.bad_truth,
)
REFUSED = (recordings.offset_stamps, recordings.depth_units)


@pytest.mark.parametrize('make', KINDS, ids=lambda kind: kind.__name__)
def test_a_recording_is_read_as_it_is_or_refused(
    make: Callable[..., Callable[[], int]], tmp_path: Path
) -> None:
    statuses = []
    for seed in (None, *range(6)):
        place = tmp_path / str(seed)
        place.mkdir()
        rng = None if seed is None else np.random.default_rng(seed)
        statuses.append(make(SAMPLES, place, rng)())
    assert statuses[0] == 0
    assert set(statuses) == ({0, 1} if make in REFUSED else {0})


def test_a_wrong_reading_is_noticed(tmp_path: Path) -> None:
    assert recordings.repeated_stamps(SAMPLES, tmp_path, None)() == 0
    images = recordings.wall_images()
    assert recordings.reading(tmp_path / 'bag', images, (recordings.RAW,), len(images))() == 0
    assert recordings.reading(tmp_path / 'bag', images, (OTHER,), len(images))() == SILENT
    assert recordings.reading(tmp_path / 'bag', images[1:], (recordings.RAW,), 1)() == SILENT
    images[0].depth_m[0, 0] += 0.01
    assert recordings.reading(tmp_path / 'bag', images, (recordings.RAW,), len(images))() == SILENT
