"""Builds the world of a floor: furnished rooms, and corridors with pictures, plants and lamps."""

from __future__ import annotations

import numpy as np

from hoid_common.values import PERSON, FloatArray
from hoid_synth.config import SceneConfig
from hoid_synth.floor.plan import (
    CORRIDOR_M,
    DOOR_M,
    ROOM_DEPTH_M,
    ROOM_WIDTH_M,
    WALL_M,
    FloorPlan,
    floor_plan,
)
from hoid_synth.mesh import Mesh, Rect, Surface, box, merged, quad
from hoid_synth.people.body import dress
from hoid_synth.room import furniture
from hoid_synth.room.rooms import HEIGHT_M, Furnisher, Slot, add_ceiling_lamp
from hoid_synth.room.world import World, WorldBuilder, pose
from hoid_synth.texture.atlas import Textures
from hoid_synth.texture.palette import Studio

_TEXELS_PER_M = 220.0  # of twelve rooms; OpenCV reads textures of at most 32,767 rows
_DOOR_TOP_M = 2.1
_LAMP_EVERY_M = 4.0
_DOOR_MARGIN_M = 0.25  # between a door and the pictures beside it
_PLANT_MARGIN_M = 0.35

Wall = tuple[tuple[float, float], tuple[float, float]]
"""Left and right end (x, y) of a wall, as seen from its corridor."""


def build_floor(config: SceneConfig) -> World:
    """Build the world of a configuration with the path "floor"."""
    rng = np.random.default_rng([config.seed, 1])
    textures, builder = Textures(), WorldBuilder()
    studio = Studio(textures, rng, _TEXELS_PER_M * min(config.scale, 1.0))
    plan = floor_plan(config.num_rooms)
    for room in plan.rooms:
        part = WorldBuilder()
        _furnish_room(Furnisher(studio, part, 0.0, ROOM_WIDTH_M))
        builder.place(part, room.pose)
    _Corridors(studio, builder, plan).furnish()
    people = Studio(
        textures,
        np.random.default_rng([config.seed, 3, *config.people_stream]),
        studio.texels_per_m,
    )
    wardrobes = tuple(dress(people) for _ in range(config.num_people))
    instances = tuple(builder.new_instance(PERSON) for _ in wardrobes)
    return World(
        builder.mesh(),
        tuple(builder.class_names),
        (),
        (),
        tuple(builder.obstacles),
        (*(room.rect for room in plan.rooms), *plan.main, *plan.cross),
        tuple(room.doorway for room in plan.rooms),
        tuple(builder.lamps),
        wardrobes,
        instances,
        textures.pack(),
    )


def _furnish_room(f: Furnisher) -> None:
    """Add walls and furniture of a room; its front wall has an open doorway in the middle."""
    sides = ('left', 'right') if f.rng.random() < 0.5 else ('right', 'left')
    accent = ('back', 'left', 'right')[int(f.rng.integers(0, 3))]
    f.shell(('front',), accent)
    _front_with_door(f)
    slots: list[Slot] = [
        (1.5, f.desk),
        (1.1, f.bookshelf),
        (1.0, f.cupboard),
        (1.5, f.sideboard),
    ]
    spans = f.along('back', slots, 0.12, f.width_m - 0.12)
    f.pictures('back', [s for s in spans if s[1] - s[0] > 1.3], 1.42)
    f.couch(f.builder, f.wall_pose(sides[0], ROOM_DEPTH_M / 2 + float(f.rng.uniform(-0.3, 0.3))))
    f.pictures(sides[0], [(0.6, 1.4), (1.7, 3.9), (4.1, 5.2)], 1.15)
    f.window(sides[1], ROOM_DEPTH_M / 2)
    f.pictures(sides[1], [(0.3, 1.4), (4.1, 5.3)], 1.1)
    f.pictures('front', [(0.3, 2.2), (4.0, f.width_m - 0.3)], 1.0)
    aside = 0.45 if sides[0] == 'left' else -0.45
    f.table_group(f.width_m / 2 + aside, 3.2 + float(f.rng.uniform(-0.15, 0.15)), 0.0)
    near = 0.45 if sides[0] == 'left' else f.width_m - 0.45
    f.standing(furniture.floor_lamp(f.studio, f.palette), near, 0.5, '', 0.16)
    f.standing(
        furniture.plant(f.studio, f.palette, 1.15), f.width_m - near, 0.6, 'potted plant', 0.2
    )


def _front_with_door(f: Furnisher) -> None:
    """Add the wall to the corridor, and the frame of its open door."""
    p, w = f.palette, f.width_m
    a, b = (w - DOOR_M) / 2, (w + DOOR_M) / 2
    parts = _wall(((w, 0), (0, 0)), [(a, b)], p.wall)
    for x in (a, b):
        parts.append(
            box((x - 0.04, -WALL_M - 0.02, 0), (x + 0.04, 0.02, _DOOR_TOP_M + 0.04), p.white)
        )
    parts.append(
        box((a, -WALL_M - 0.02, _DOOR_TOP_M - 0.03), (b, 0.02, _DOOR_TOP_M + 0.04), p.white)
    )
    parts.append(box((a, -WALL_M, -0.02), (b, 0, 0.004), p.wood))
    f.builder.add(merged(parts), np.eye(4))


def _wall(wall: Wall, gaps: list[tuple[float, float]], s: Surface) -> list[Mesh]:
    """Return a wall with door openings, given by distances from its left end."""
    start, end = (np.array(point, float) for point in wall)
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length

    def piece(a: float, b: float, low: float) -> Mesh:
        origin = (*(start + a * along), HEIGHT_M)
        return quad(origin, (*((b - a) * along), 0.0), (0, 0, low - HEIGHT_M), s)

    edges = [0.0, *(x for gap in gaps for x in gap), length]
    pieces = [piece(a, b, 0.0) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return pieces + [piece(a, b, _DOOR_TOP_M) for a, b in gaps]


class _Corridors(Furnisher):
    """Places walls, floors, lamps and pictures of all corridors."""

    def __init__(self, studio: Studio, builder: WorldBuilder, plan: FloorPlan) -> None:
        super().__init__(studio, builder, 0.0, 0.0)
        self._plan = plan
        self._walls: dict[str, tuple[Wall, list[tuple[float, float]]]] = {}
        for corridor in range(len(plan.main)):
            self._define_main_walls(corridor)
        if plan.cross:
            self._define_cross_walls()
        else:
            x1, y1, x2, y2 = plan.main[0]
            self._walls['west'] = ((x1, y1), (x1, y2)), []
            self._walls['east'] = ((x2, y2), (x2, y1)), []

    def wall_pose(self, wall: str, along_m: float) -> FloatArray:
        """Return the pose (4, 4) of things at a wall, `along_m` from the wall's left end."""
        start, end = (np.array(point, float) for point in self._walls[wall][0])
        along = (end - start) / np.linalg.norm(end - start)
        x, y = start + along_m * along
        return pose(float(x), float(y), 0, float(np.arctan2(along[1], along[0])))

    def furnish(self) -> None:
        """Add everything."""
        p = self.palette
        for name, (wall, gaps) in self._walls.items():
            self.builder.add(merged(_wall(wall, gaps, p.wall)), np.eye(4))
            self.pictures(name, self._free_spans(wall, gaps), 1.0)
        for rect in self._floors():
            self._floor(rect)
        if self._plan.cross:
            self._corner_plants()

    def _define_main_walls(self, corridor: int) -> None:
        x1, y1, x2, y2 = self._plan.main[corridor]
        rooms = self._plan.rooms_of(corridor)
        is_ring = bool(self._plan.cross)
        for side, y, is_inner in (('south', y1, corridor == 1), ('north', y2, corridor == 0)):
            inset = CORRIDOR_M if is_ring and is_inner else 0.0
            left, right = (x1 + inset, x2 - inset)
            doors = sorted(
                room.door_x_m for room in rooms if room.is_door_north == (side == 'south')
            )
            if side == 'north':  # seen towards +y, x runs to the right
                wall, at = ((left, y), (right, y)), [x - left for x in doors]
            else:
                wall, at = ((right, y), (left, y)), sorted(right - x for x in doors)
            gaps = [(x - DOOR_M / 2, x + DOOR_M / 2) for x in at]
            self._walls[f'{corridor} {side}'] = wall, gaps

    def _define_cross_walls(self) -> None:
        (_, low, _, _), (_, _, _, high) = self._plan.main
        (wx1, _, wx2, _), (ex1, _, ex2, _) = self._plan.cross
        inner_low, inner_high = low + CORRIDOR_M, high - CORRIDOR_M
        # Seen towards -x, y runs to the right.
        self._walls['west outer'] = ((wx1, low), (wx1, high)), []
        self._walls['east inner'] = ((ex1, inner_low), (ex1, inner_high)), []
        self._walls['west inner'] = ((wx2, inner_high), (wx2, inner_low)), []
        self._walls['east outer'] = ((ex2, high), (ex2, low)), []

    @staticmethod
    def _free_spans(wall: Wall, gaps: list[tuple[float, float]]) -> list[tuple[float, float]]:
        length = float(np.linalg.norm(np.subtract(*wall)))
        m = _DOOR_MARGIN_M
        edges = [m, *(x for a, b in gaps for x in (a - m, b + m)), length - m]
        return list(zip(edges[::2], edges[1::2], strict=True))

    def _floors(self) -> list[Rect]:
        """Return the floors of the corridors without overlap."""
        inner = [(x1, y1 + CORRIDOR_M, x2, y2 - CORRIDOR_M) for x1, y1, x2, y2 in self._plan.cross]
        return [*self._plan.main, *inner]

    def _floor(self, rect: Rect) -> None:
        """Add floor, ceiling and lamps of a corridor."""
        x1, y1, x2, y2 = rect
        w, d, p = x2 - x1, y2 - y1, self.palette
        ground = quad((x1, y2, 0), (w, 0, 0), (0, -d, 0), p.floor)
        ceiling = quad((x1, y1, HEIGHT_M), (w, 0, 0), (0, d, 0), p.ceiling)
        self.builder.add(merged([ground, ceiling]), np.eye(4))
        count = max(1, round(max(w, d) / _LAMP_EVERY_M))
        for share in (np.arange(count) + 0.5) / count:
            x = x1 + (share if w > d else 0.5) * w
            y = y1 + (share if d >= w else 0.5) * d
            add_ceiling_lamp(self.studio, self.builder, float(x), float(y))

    def _corner_plants(self) -> None:
        x1, y1, x2, _ = self._plan.main[0]
        y2, m = self._plan.main[1][3], _PLANT_MARGIN_M
        for x in (x1 + m, x2 - m):
            for y in (y1 + m, y2 - m):
                self.standing(
                    furniture.plant(self.studio, self.palette, 1.3), x, y, 'potted plant', 0.2
                )
