"""Which parts of a route show a place again."""

from __future__ import annotations

import numpy as np

from hoid_benchmarks.building.tours.revisits import revisits
from hoid_benchmarks.building.tours.tour import length_m, tour_route
from hoid_benchmarks.building.world.floors import STOREY_M, Building
from hoid_benchmarks.building.world.route import Route


def test_a_second_round_is_a_revisit_from_its_first_corridor_to_its_last() -> None:
    route = Route(Building(1, 1))
    route.around(1, 1)
    first_round_s = len(route) / 10
    route.around(1, 1)

    found = revisits(route.trajectory())

    assert sum(r.last_s - r.first_s for r in found) > 0.8 * (len(route) / 10 - first_round_s)
    assert all(r.first_s > first_round_s for r in found)
    assert all(r.seen_s < r.first_s - 30 for r in found)


def test_the_way_back_in_the_other_direction_shows_other_views() -> None:
    route = Route(Building(3, 1))
    route.to_junction(3, 0)
    route.to_junction(0, 0)

    assert revisits(route.trajectory()) == []


def test_the_same_place_on_another_floor_is_no_revisit() -> None:
    route = Route(Building(2, 1, floors=2))
    route.to_junction(2, 0)
    route.to_junction(0, 0)
    route.climb()
    upstairs_s = len(route) / 10
    route.to_junction(2, 0)

    assert not [r for r in revisits(route.trajectory()) if r.first_s > upstairs_s]


def test_a_tour_has_its_length_on_all_floors() -> None:
    building = Building(floors=2)
    T = tour_route(building, 300).poses()

    assert 600 < length_m(T) < 1200
    for floor in range(2):
        on_floor = np.abs(T[:, 2, 3] - 1.1 - floor * STOREY_M) < 0.1
        assert length_m(T[on_floor]) > 250
    cell = None
    for pose in T[::5]:
        cell = building.cell_at(pose[:3, 3], cell)
