"""`hoid bench building`: SLAM in a simulated building, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from hoid_benchmarks.building.growth import SIZES, growth
from hoid_benchmarks.building.lag import CONSTANT_S, lag
from hoid_benchmarks.building.large_map import large_maps
from hoid_benchmarks.building.report import Outcome
from hoid_benchmarks.building.tour import tour
from hoid_benchmarks.building.world.route import CORNER
from hoid_common.errors import InputError

_QUICK_STALL_S = 4.0
_QUICK_SIZES = (100, 1000)
SCENARIOS = ('lag', 'growth', 'loop', 'tour')


def building_report(
    only: Sequence[str],
    seed: int,
    out: Path,
    *,
    quick: bool = False,
    delays_s: Sequence[float] = (),
    sizes: Sequence[int] = (),
) -> Iterator[str]:
    """Run scenarios, write a JSON file for each, and yield their tables.

    Args:
        only: Names of the scenarios to run; empty means all scenarios.
        seed: Seed of the building, the route and the camera.
        out: Folder of the files.
        quick: Whether to run only the part that takes a minute.
        delays_s: Constant delays of the mapper; empty means the default delays.
        sizes: Numbers of keyframes; empty means the default numbers.

    Raises:
        InputError: There is no such scenario.
    """
    if unknown := sorted(set(only) - set(SCENARIOS)):
        raise InputError(f'no scenario {unknown[0]}: {", ".join(SCENARIOS)}')
    usual_sizes = _QUICK_SIZES if quick else SIZES
    run: dict[str, Callable[[], Outcome]] = {
        'lag': lambda: (
            lag(seed, (), (_QUICK_STALL_S,), (CORNER,))
            if quick
            else lag(seed, delays_s or CONSTANT_S)
        ),
        'growth': lambda: growth(seed, sizes or usual_sizes),
        'loop': lambda: large_maps(seed, sizes or usual_sizes),
        'tour': lambda: tour(seed),
    }
    for name in only or SCENARIOS:
        outcome = run[name]()
        yield f'{outcome.table()}\n{outcome.write(out, seed)}\n\n'
