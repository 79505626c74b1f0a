"""Builds the world of a configuration: one room, or two rooms joined by two doorways."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hoid_common.values import PERSON, FloatArray
from hoid_synth.config import SceneConfig
from hoid_synth.mesh import Rect, box, merged
from hoid_synth.noise import Rng
from hoid_synth.people.body import dress
from hoid_synth.room import furniture
from hoid_synth.room.away import rearrange
from hoid_synth.room.movers import make_mover
from hoid_synth.room.props import FLOOR_PROPS, TABLE_PROPS, Maker
from hoid_synth.room.rooms import DEPTH_M, HEIGHT_M, Furnisher
from hoid_synth.room.world import (
    PlacedProp,
    Spot,
    World,
    WorldBuilder,
    resting_yaw,
)
from hoid_synth.texture.atlas import Textures
from hoid_synth.texture.palette import Studio

WIDTHS_M = (6.4, 5.8)
PARTITION_M = 0.12
DOORWAYS_M = ((0.55, 1.55), (3.92, 4.92))  # y ranges of the openings between the rooms
LANES_Y_M = (1.05, 4.42)  # y of the paths through the doorways
PASSAGE_Y_M = (1.45, 3.3)  # kept free for people who walk as a group
DOORWAY_HEIGHT_M = 2.1
_TABLE_BEYOND_PASSAGE_Y_M = 3.85
_TEXELS_PER_M = 260.0
_NUM_TABLE_PROPS = 5
_NUM_FLOOR_PROPS = 3
_FLOOR_SPOTS = 9

Place = Callable[[WorldBuilder, FloatArray], None]


def build_world(config: SceneConfig) -> World:
    """Build the world of a configuration; the path "loop" has two rooms, the others one."""
    rng = np.random.default_rng([config.seed, 1])
    textures, builder = Textures(), WorldBuilder()
    studio = Studio(textures, rng, _TEXELS_PER_M * min(config.scale, 1.0))
    two = config.path == 'loop'
    x0s = (0.0, WIDTHS_M[0] + PARTITION_M)[: 1 + two]
    turns = np.random.default_rng([config.seed, 7]) if config.turned else None
    furnishers = [
        Furnisher(studio, builder, x0, w, turns, is_bare=config.bare)
        for x0, w in zip(x0s, WIDTHS_M, strict=False)
    ]
    for k, furnisher in enumerate(furnishers):
        _furnish(furnisher, k, config)
    rooms = tuple((x0, 0.0, x0 + w, DEPTH_M) for x0, w in zip(x0s, WIDTHS_M, strict=False))
    doorways = _partition(furnishers[0]) if two else ()
    builder.spots += _floor_spots(rng, builder.obstacles, rooms, config)
    props, free = _place_props(furnishers[0], rng)
    people = Studio(
        textures,
        np.random.default_rng([config.seed, 3, *config.people_stream]),
        studio.texels_per_m,
    )
    num_people = config.carriers or config.num_people
    wardrobes = tuple(dress(people) for _ in range(num_people))
    instances = tuple(builder.new_instance(PERSON) for _ in wardrobes)
    mover = None
    if config.event:
        made = make_mover(config.event, people, furnishers[0].palette)
        mover = made, builder.new_instance(made.class_name)
    if config.away_seed:
        away = Studio(
            textures,
            np.random.default_rng([config.seed, 5, config.away_seed]),
            studio.texels_per_m,
        )
        props, free = rearrange(away, furnishers[0].palette, builder, props, free)
    return World(
        builder.mesh(),
        tuple(builder.class_names),
        props,
        free,
        tuple(builder.obstacles),
        rooms,
        doorways,
        tuple(builder.lamps),
        wardrobes,
        instances,
        textures.pack(),
        mover,
    )


def _furnish(f: Furnisher, k: int, config: SceneConfig) -> None:
    two = config.path == 'loop'
    sides = ('left', 'right') if k == 0 else ('right', 'left')
    if not two and f.rng.random() < 0.5:
        sides = ('right', 'left')
    accent = ('back', 'left', 'right', 'front')[int(f.rng.integers(0, 4))]
    f.shell((sides[1],) if two else (), accent)
    slots: list[tuple[float, Place]] = [
        (1.5, f.desk),
        (1.1, f.bookshelf),
        (1.0, f.cupboard),
        (1.5, f.sideboard),
    ]
    if config.layout == 'repeated':
        slots = [(1.5, _repeating(f, f.desk))] * 3
    spans = f.along('back', slots, 0.12, f.width_m - 0.12)
    wide = [s for s in spans if s[1] - s[0] > 1.3]
    f.pictures('back', wide, 1.42)
    for span in [s for s in spans if s not in wide][:1]:
        f.clock('back', float(np.mean(span)))
    if not config.together:
        f.couch(f.builder, f.wall_pose(sides[0], DEPTH_M / 2 + float(f.rng.uniform(-0.3, 0.3))))
    f.pictures(sides[0], [(0.6, 1.4), (1.7, 3.9), (4.1, 5.2)], 1.15)
    _window_side(f, sides[1], two)
    aside = 0.0 if two else 1.05 if sides[0] == 'left' else -1.05
    middle = f.width_m / 2 + aside + float(f.rng.uniform(-0.15, 0.15))
    if config.together:
        f.table_group(middle, _TABLE_BEYOND_PASSAGE_Y_M, 0.0)
    else:
        f.table_group(
            middle,
            2.72 if two else 3.15,
            0.0 if two else np.pi / 2 + float(f.rng.uniform(-0.1, 0.1)) + f.turn_rad(np.pi / 2),
        )
    near = 0.45 if sides[0] == 'left' else f.width_m - 0.45
    f.standing(furniture.floor_lamp(f.studio, f.palette), near, 4.7, '', 0.16)
    f.standing(
        furniture.plant(f.studio, f.palette, 1.15), f.width_m - near, 5.1, 'potted plant', 0.2
    )


def _window_side(f: Furnisher, side: str, two: bool) -> None:
    """Furnish the wall opposite the sofa; with two rooms, the window is in the front wall."""
    wall = 'front' if two else side
    middle = f.width_m / 2 if two else DEPTH_M / 2
    f.window(wall, middle)
    if two:
        f.pictures('front', [(0.3, 1.4), (f.width_m - 1.4, f.width_m - 0.3)], 1.1)
        f.pictures(side, [(1.8, 3.7)], 1.1)
        return
    f.builder.add(furniture.door(f.studio, f.palette), f.wall_pose(side, 0.75))
    f.pictures(side, [(4.1, 5.3)], 1.1)
    f.pictures('front', [(0.4, 2.6), (3.2, f.width_m - 0.4)], 1.0)


def _repeating(f: Furnisher, place: Place) -> Place:
    """Return a placer that repeats its random numbers, so that all pieces are identical."""
    state = f.rng.bit_generator.state

    def place_again(builder: WorldBuilder, T_world_thing: FloatArray) -> None:
        now = f.rng.bit_generator.state
        f.rng.bit_generator.state = state
        place(builder, T_world_thing)
        f.rng.bit_generator.state = now

    return place_again


def _partition(f: Furnisher) -> tuple[Rect, ...]:
    """Add the wall between the rooms; return the floor areas of its doorways."""
    x0, x1 = WIDTHS_M[0], WIDTHS_M[0] + PARTITION_M
    paint = f.palette.accent
    (a, b), (c, d) = DOORWAYS_M
    parts = [
        box((x0, y, 0), (x1, end, HEIGHT_M), paint, omit=('top', 'bottom'))
        for y, end in ((0, a), (b, c), (d, DEPTH_M))
    ]
    parts += [box((x0, y, DOORWAY_HEIGHT_M), (x1, end, HEIGHT_M), paint) for y, end in DOORWAYS_M]
    frame = f.studio.wood((90.0, 120.0, 150.0))
    for y, end in DOORWAYS_M:
        for side in (y, end):
            parts.append(box((x0 - 0.02, side - 0.04, 0), (x1 + 0.02, side + 0.04, 2.14), frame))
        parts.append(box((x0 - 0.02, y, 2.07), (x1 + 0.02, end, 2.14), frame))
        parts.append(box((x0, y, -0.02), (x1, end, 0.004), frame))
    f.builder.add(merged(parts), np.eye(4))
    f.builder.obstacles += [(x0, y, x1, end) for y, end in ((0.0, a), (b, c), (d, DEPTH_M))]
    return tuple((x0, y, x1, end) for y, end in DOORWAYS_M)


def _floor_spots(
    rng: Rng, obstacles: list[Rect], rooms: tuple[Rect, ...], config: SceneConfig
) -> list[Spot]:
    """Return random free places on the floor beside the lanes, with space for a person."""
    rects = np.array(obstacles)
    two = config.path == 'loop'
    front_m = PASSAGE_Y_M[1] + 0.25 if config.together else 1.7
    spots: list[Spot] = []
    for _ in range(4000):
        if len(spots) == _FLOOR_SPOTS * len(rooms):
            break
        room = rooms[int(rng.integers(0, len(rooms)))]
        at = rng.uniform([room[0] + 0.4, 0.4], [room[2] - 0.4, DEPTH_M - 0.4])
        middle = np.array([(room[0] + room[2]) / 2, at[1] + rng.uniform(-1, 1)])
        way = (middle - at) / np.linalg.norm(middle - at)
        stand = at + 0.5 * way
        lane = min(abs(at[1] - y) for y in LANES_Y_M) < 0.55 if two else at[1] < front_m
        if lane or _clearance(at, rects) < 0.36 or _clearance(stand, rects) < 0.3:
            continue
        if any(np.hypot(*(at - s.position_m[:2])) < 0.75 for s in spots):
            continue
        heading = float(np.arctan2(-way[1], -way[0]))
        spots.append(
            Spot(
                (float(at[0]), float(at[1]), 0.0),
                (float(stand[0]), float(stand[1])),
                heading,
                True,
            )
        )
    return spots


def _clearance(at: FloatArray, rects: FloatArray) -> float:
    gap = np.maximum(np.maximum(rects[:, :2] - at, at - rects[:, 2:]), 0)
    return float(np.hypot(gap[:, 0], gap[:, 1]).min())


def _place_props(f: Furnisher, rng: Rng) -> tuple[tuple[PlacedProp, ...], tuple[Spot, ...]]:
    """Place objects at random spots; return them and the free spots."""
    placed: list[PlacedProp] = []
    builder = f.builder
    free = [builder.spots[int(k)] for k in rng.permutation(len(builder.spots))]
    groups: list[tuple[tuple[Maker, ...], int, bool]] = [
        (TABLE_PROPS, _NUM_TABLE_PROPS, False),
        (FLOOR_PROPS, _NUM_FLOOR_PROPS, True),
    ]
    for makers, count, on_floor in groups:
        for k in rng.permutation(len(makers))[:count]:
            spot = next((s for s in free if s.on_floor == on_floor), None)
            if spot is None:
                break
            free.remove(spot)
            prop = makers[int(k)](f.studio, f.palette)
            yaw = resting_yaw(prop, spot) + float(rng.uniform(-0.4, 0.4))
            placed.append(PlacedProp(prop, spot, yaw, builder.new_instance(prop.class_name)))
    return tuple(placed), tuple(free)
