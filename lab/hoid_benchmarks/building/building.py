"""`hoid bench building`: SLAM in a simulated building, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from hoid_benchmarks.building.growth import SIZES, growth
from hoid_benchmarks.building.lag import CONSTANT_S, lag
from hoid_benchmarks.building.large_map import large_maps
from hoid_benchmarks.building.merge import SIZE as MERGED
from hoid_benchmarks.building.merge import merge
from hoid_benchmarks.building.report import Outcome
from hoid_benchmarks.building.tours.alike import alike
from hoid_benchmarks.building.tours.floor import SMALL, floor
from hoid_benchmarks.building.tours.slow import SIZES as SLOW_SIZES
from hoid_benchmarks.building.tours.slow import slow
from hoid_benchmarks.building.tours.tour import DEFAULT_WAY_M, tour
from hoid_benchmarks.building.world.route import CORNER
from hoid_common.errors import InputError

_QUICK_STALL_S = 4.0
_QUICK_SIZES = (100, 1000)
SCENARIOS = ('lag', 'growth', 'loop', 'tour', 'alike', 'slow', 'merge', 'floor')


def building_report(
    only: Sequence[str],
    seed: int,
    out: Path,
    *,
    quick: bool = False,
    delays_s: Sequence[float] = (),
    sizes: Sequence[int] = (),
    num_floors: int = 1,
    way_m: float = DEFAULT_WAY_M,
    num_rooms: int = SMALL,
) -> Iterator[str]:
    """Run scenarios, write a JSON file for each, and yield their tables.

    Args:
        only: Names of the scenarios to run; empty means all scenarios.
        seed: Seed of the building, the route and the camera.
        out: Folder of the files.
        quick: Whether to run only the part that takes a minute.
        delays_s: Constant delays of the mapper; empty means the default delays.
        sizes: Numbers of keyframes; empty means the default numbers.
        num_floors: Number of floors of the tour.
        way_m: Length of the tour.
        num_rooms: Number of rooms of the rendered floor.

    Raises:
        InputError: There is no such scenario.
    """
    if unknown := sorted(set(only) - set(SCENARIOS)):
        raise InputError(f'no scenario {unknown[0]}: {", ".join(SCENARIOS)}')
    usual_sizes = _QUICK_SIZES if quick else SIZES
    usual_merge = (_QUICK_SIZES[-1] if quick else MERGED,)
    run: dict[str, Callable[[], Outcome]] = {
        'lag': lambda: (
            lag(seed, (), (), (_QUICK_STALL_S,), (CORNER,))
            if quick
            else lag(seed, delays_s or CONSTANT_S)
        ),
        'growth': lambda: growth(seed, sizes or usual_sizes),
        'loop': lambda: large_maps(seed, sizes or usual_sizes),
        'tour': lambda: tour(seed, num_floors, way_m),
        'alike': lambda: alike(seed),
        'slow': lambda: slow(seed, sizes or (_QUICK_SIZES if quick else SLOW_SIZES)),
        'merge': lambda: merge(seed, (sizes or usual_merge)[0]),
        'floor': lambda: floor(seed, num_rooms, out.parent.absolute() / 'sequences', out),
    }
    for name in only or SCENARIOS:
        outcome = run[name]()
        yield f'{outcome.table()}\n{outcome.write(out, seed)}\n\n'
