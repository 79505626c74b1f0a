"""What changed in a room while nobody watched: things that were moved, taken and added.

No two changed things have the same class: equal things cannot be distinguished, so that nobody
could know which of two chairs was taken and which one was moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hoid_common.values import Float32Array, FloatArray
from hoid_synth.noise import Rng
from hoid_synth.room.props import FLOOR_PROPS, TABLE_PROPS
from hoid_synth.room.world import PlacedProp, Spot, WorldBuilder, pose, resting_yaw
from hoid_synth.texture.palette import Palette, Studio

# Chosen: enough for a score, and few enough that most of the room stays as it was.
_NUM_MOVED, _NUM_TAKEN, _NUM_ADDED = 3, 3, 2
_FURNITURE = ('chair', 'potted plant')  # classes of furniture that one person moves


def rearrange(
    studio: Studio,
    palette: Palette,
    builder: WorldBuilder,
    props: Sequence[PlacedProp],
    free: Sequence[Spot],
) -> tuple[tuple[PlacedProp, ...], tuple[Spot, ...]]:
    """Move, take and add things; unchanged and moved things keep their instances.

    Args:
        studio: Its random numbers choose the changes.
        palette: Materials of the room.
        builder: The furnished room, whose furniture is changed.
        props: The movable objects.
        free: The free spots.

    Returns:
        The movable objects and the free spots afterwards. Spots that became free are not used
        again for added or moved things, and are free afterwards.
    """
    rng, spots = studio.rng, list(free)
    placed = {item.instance: item for item in props}
    standing = [k for k, name in enumerate(builder.class_names) if name in _FURNITURE]
    movable = sorted({*placed, *standing})
    changed: set[str] = set()
    num_moved = num_taken = 0
    for instance in (movable[int(k)] for k in rng.permutation(len(movable))):
        name, spot = builder.class_names[instance], None
        if name in changed:
            continue
        if num_moved < _NUM_MOVED:
            on_floor = instance not in placed or placed[instance].prop.on_floor
            spot = _take_spot(spots, on_floor)
        if spot is None and num_taken == _NUM_TAKEN:
            continue
        num_moved, num_taken = num_moved + (spot is not None), num_taken + (spot is None)
        changed.add(name)
        _change(builder, placed, instance, spot, rng)
    placed |= _added(studio, palette, builder, spots, changed | {p.prop.class_name for p in props})
    used = {item.spot for item in placed.values()}
    return tuple(placed.values()), tuple(s for s in builder.spots if s not in used)


def _take_spot(spots: list[Spot], on_floor: bool) -> Spot | None:
    """Remove and return the first free spot of a kind; None if there is none."""
    spot = next((s for s in spots if s.on_floor == on_floor), None)
    if spot is not None:
        spots.remove(spot)
    return spot


def _change(
    builder: WorldBuilder,
    placed: dict[int, PlacedProp],
    instance: int,
    spot: Spot | None,
    rng: Rng,
) -> None:
    """Move a thing to a spot, or take it away without one."""
    if instance not in placed:
        _change_furniture(builder, instance, spot, rng)
    elif spot is None:
        del placed[instance]
    else:
        placed[instance] = _at(placed[instance], spot, rng)


def _at(item: PlacedProp, spot: Spot, rng: Rng) -> PlacedProp:
    yaw = resting_yaw(item.prop, spot) + float(rng.uniform(-0.4, 0.4))
    return replace(item, spot=spot, yaw_rad=yaw)


def _added(
    studio: Studio,
    palette: Palette,
    builder: WorldBuilder,
    spots: list[Spot],
    known: set[str],
) -> dict[int, PlacedProp]:
    """Return new things by instance, at free spots, of other classes than the known ones."""
    makers = (*TABLE_PROPS, *FLOOR_PROPS)
    out: dict[int, PlacedProp] = {}
    for k in studio.rng.permutation(len(makers)):
        prop = makers[int(k)](studio, palette)
        if len(out) == _NUM_ADDED or prop.class_name in known:
            continue
        spot = _take_spot(spots, prop.on_floor)
        if spot is not None:
            instance = builder.new_instance(prop.class_name)
            out[instance] = _at(PlacedProp(prop, spot, 0.0, instance), spot, studio.rng)
    return out


def _change_furniture(builder: WorldBuilder, instance: int, spot: Spot | None, rng: Rng) -> None:
    """Move furniture to a spot on the floor, or take it away without one."""
    row = next(m for m, mesh in enumerate(builder.meshes) if (mesh.instance == instance).all())
    mesh = builder.meshes.pop(row)
    middle_m = _middle(mesh.vertices_m)
    inside = [
        rect
        for rect in builder.obstacles
        if rect[0] <= middle_m[0] <= rect[2] and rect[1] <= middle_m[1] <= rect[3]
    ]
    footprint = min(inside, key=lambda r: (r[2] - r[0]) * (r[3] - r[1]))
    builder.obstacles.remove(footprint)
    if spot is None:
        return
    turned = mesh.transformed(pose(0, 0, 0, float(rng.uniform(-np.pi, np.pi))))
    x, y = np.array(spot.position_m[:2]) - _middle(turned.vertices_m)
    builder.meshes.insert(row, turned.transformed(pose(float(x), float(y), 0, 0)))
    half = (footprint[2] - footprint[0]) / 2, (footprint[3] - footprint[1]) / 2
    x, y, _ = spot.position_m
    builder.obstacles.append((x - half[0], y - half[1], x + half[0], y + half[1]))


def _middle(vertices_m: Float32Array) -> FloatArray:
    """Return the middle (2,) of the footprint of vertices (V, 3)."""
    low, high = vertices_m[:, :2].min(0), vertices_m[:, :2].max(0)
    return np.asarray(low + high, np.float64) / 2
