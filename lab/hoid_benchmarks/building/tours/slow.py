"""Scenario `slow`: tracking in a large map on a computer of half the speed.

The mapper answers after twice its own CPU time. The route leads on from the end of the map, with
its corners and turns in rooms.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hoid_benchmarks.building.drive import Drive
from hoid_benchmarks.building.growth import driven_map
from hoid_benchmarks.building.lag import longest_detached_s
from hoid_benchmarks.building.report import Outcome
from hoid_benchmarks.building.tiled_map import tiled_to
from hoid_benchmarks.building.virtual_mapper import Delay
from hoid_benchmarks.building.world.camera import FeatureCamera
from hoid_benchmarks.building.world.floors import Building

SIZES = (3000, 9900)
_CPU_FACTOR = 2.0
_WARM_UP_IMAGES = 20  # relocalization
_NUM_IMAGES = 900
_COLUMNS = {
    'keyframes': 'd',
    'new keyframes': 'd',
    'longest detached s': '.1f',
    'images lost': 'd',
    'joins': 'd',
    'false joins': 'd',
    'joins without a loop': 'd',
    'longest answer s': '.1f',
    'keyframe ms': '.1f',
}


def slow(seed: int, sizes: Sequence[int] = SIZES) -> Outcome:
    """Return attachment and joins on a route in maps of different sizes."""
    building = Building(seed=seed)
    truth, last, base = driven_map(building, seed)
    rows: list[dict[str, Any]] = []
    for size in sizes:
        content = tiled_to(base, size, seed)
        delay = Delay(cpu_factor=_CPU_FACTOR)
        with Drive(FeatureCamera(building, seed), truth, delay, content=content) as drive:
            num_keyframes = drive.num_keyframes
            drive.run(last, last + _WARM_UP_IMAGES + _NUM_IMAGES)
            images, answers = drive.images[_WARM_UP_IMAGES:], drive.worker.answers
            rows.append(
                {
                    'keyframes': num_keyframes,
                    'new keyframes': drive.num_keyframes - num_keyframes,
                    'longest detached s': longest_detached_s(images),
                    'images lost': sum(not image.is_tracked for image in images),
                    'joins': len(drive.joins),
                    'false joins': drive.num_false_joins,
                    'joins without a loop': sum(not join.has_left for join in drive.joins),
                    'longest answer s': max(a.answer_s - a.request_s for a in answers),
                    'keyframe ms': float(np.median([answer.cpu_ms for answer in answers])),
                    'tracked': [image.num_tracked for image in images],
                }
            )
    return Outcome('slow', 'A large map on a computer of half the speed', _COLUMNS, rows)
