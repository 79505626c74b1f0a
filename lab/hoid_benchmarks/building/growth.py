"""Scenario `growth`: what an image and a keyframe cost in maps of different sizes.

A map of 100 keyframes is driven and then tiled to the wanted sizes. The same images are processed
in each, so that nothing but the size of the map differs. A checkpoint is written before and after
a minute of driving, and the map is saved and loaded again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hoid_benchmarks.building.drive import Drive
from hoid_benchmarks.building.files import checkpoint_costs, load_costs
from hoid_benchmarks.building.report import Outcome
from hoid_benchmarks.building.tiled_map import BASE_KEYFRAMES, tiled_to
from hoid_benchmarks.building.world.camera import FeatureCamera
from hoid_benchmarks.building.world.floors import Building
from hoid_benchmarks.building.world.route import RATE_HZ, Route
from hoid_common.values import Trajectory
from rgbd_slam.store.map_file import MapFile

SIZES = (100, 1000, 10000)
_WARM_UP_IMAGES = 20  # relocalization and first calls
_NUM_IMAGES = 200
_MINUTE_IMAGES = round(60 * RATE_HZ)
_COLUMNS = {
    'keyframes': 'd',
    'points': 'd',
    'image ms': '.2f',
    'image p95 ms': '.2f',
    'ratio': '.2f',
    'keyframe ms': '.1f',
    'keyframe p95 ms': '.1f',
    'change kB': '.0f',
    'measured keyframes': 'd',
    'tracked': '.0f',
    'first checkpoint MB': '.0f',
    'first checkpoint s': '.2f',
    'new keyframes': 'd',
    'checkpoint MB': '.1f',
    'checkpoint ms': '.0f',
    'copy ms': '.1f',
    'read s': '.1f',
    'load s': '.1f',
    'swap ms': '.0f',
}


def growth(seed: int, sizes: Sequence[int] = SIZES) -> Outcome:
    """Return durations per image (track and learn) and per keyframe (map) for each map size."""
    building = Building(seed=seed)
    truth, last, base = driven_map(building, seed)
    rows: list[dict[str, Any]] = []
    for size in sizes:
        content = tiled_to(base, size, seed)
        row = _measured(building, seed, truth, last, content)
        ratio = row['image ms'] / (rows[0] if rows else row)['image ms']
        rows.append(row | {'ratio': ratio})
    return Outcome('growth', 'Growth of the map (one core)', _COLUMNS, rows)


def driven_map(building: Building, seed: int) -> tuple[Trajectory, int, MapFile]:
    """Drive until the map has 100 keyframes; return the route, the images driven, and the map.

    The seed determines the noise of the camera and its path.
    """
    route = Route(building)
    route.around(4, 2, rooms=1, every=2)
    truth = route.trajectory(seed)
    with Drive(FeatureCamera(building, seed), truth) as drive:
        while drive.num_keyframes < BASE_KEYFRAMES:
            n = len(drive.images)
            drive.run(n, n + 1)
        drive.session.map.finish()
        return truth, len(drive.images), drive.session.map.export()


def _measured(
    building: Building, seed: int, truth: Trajectory, first: int, content: MapFile
) -> dict[str, Any]:
    """Continue the route in a saved map, and measure."""
    with Drive(FeatureCamera(building, seed), truth, content=content) as drive:
        num_keyframes, num_points = drive.num_keyframes, len(content.map.position_m)
        drive.run(first, first + _WARM_UP_IMAGES)
        warm, num_answers = len(drive.images), len(drive.worker.answers)
        first += _WARM_UP_IMAGES
        drive.run(first, first + _NUM_IMAGES)
        images = drive.images[warm:]
        answers = drive.worker.answers[num_answers:]
        first += _NUM_IMAGES
        files = checkpoint_costs(drive, lambda: drive.run(first, first + _MINUTE_IMAGES))
        files |= load_costs(drive)
        cpu_ms = np.array([image.cpu_ms for image in images])
        map_ms = np.array([answer.cpu_ms for answer in answers])
        return {
            'keyframes': num_keyframes,
            'points': num_points,
            'image ms': float(np.median(cpu_ms)),
            'image p95 ms': float(np.percentile(cpu_ms, 95)),
            'image max ms': float(cpu_ms.max()),
            'keyframe ms': float(np.median(map_ms)),
            'keyframe p95 ms': float(np.percentile(map_ms, 95)),
            'change kB': float(np.median([answer.num_bytes for answer in answers])) / 1e3,
            'measured keyframes': len(answers),
            'tracked': float(np.median([image.num_tracked for image in images])),
            'lost': sum(not image.is_tracked for image in images),
        } | files
