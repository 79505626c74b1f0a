"""Static content of a scene, and the initial places of movable objects."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hoid_common import se3
from hoid_common.values import FloatArray
from hoid_synth.mesh import Mesh, Rect, merged
from hoid_synth.people.body import Wardrobe
from hoid_synth.room.movers import Mover
from hoid_synth.room.props import Prop
from hoid_synth.texture.atlas import TextureAtlas


@dataclass(frozen=True)
class Spot:
    """A place for an object, and the position of a person who reaches for it."""

    position_m: tuple[float, float, float]
    stand_m: tuple[float, float]
    heading_rad: float  # of the person
    on_floor: bool


def resting_yaw(prop: Prop, spot: Spot) -> float:
    """Return the yaw of an object after it was put down, as it was held."""
    return spot.heading_rad - np.pi / 2 + prop.hold_yaw_rad


@dataclass(frozen=True, eq=False)
class PlacedProp:
    """A movable object at its initial place."""

    prop: Prop
    spot: Spot
    yaw_rad: float
    instance: int


@dataclass(frozen=True, eq=False)
class Lamp:
    """An area light, given by points on it."""

    points_m: FloatArray  # (K, 3)
    strength: float


@dataclass(frozen=True, eq=False)
class World:
    """A furnished home; x and y are along the walls, z up, the origin is in a floor corner."""

    static: Mesh  # mesh of everything that never moves
    class_names: tuple[str, ...]  # by instance; '' for the background (0) and without a class
    props: tuple[PlacedProp, ...]
    spots: tuple[Spot, ...]  # free places for objects
    obstacles: tuple[Rect, ...]  # footprints of furniture
    rooms: tuple[Rect, ...]  # floors
    doorways: tuple[Rect, ...]  # floors between rooms
    lamps: tuple[Lamp, ...]
    wardrobes: tuple[Wardrobe, ...]  # one for each person
    person_instances: tuple[int, ...]
    atlas: TextureAtlas
    mover: tuple[Mover, int] | None = None  # object of an event, and its instance


def pose(x_m: float, y_m: float, z_m: float, yaw_rad: float) -> FloatArray:
    """Return the pose (4, 4) of an upright object."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0, x_m], [s, c, 0, y_m], [0, 0, 1.0, z_m], [0, 0, 0, 1.0]])


def upright_poses(
    xy_m: FloatArray, z_m: FloatArray | float, yaw_rad: FloatArray | float
) -> FloatArray:
    """Return the poses (N, 4, 4) of an upright object at positions (N, 2)."""
    T = np.tile(np.eye(4), (len(xy_m), 1, 1))
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1] = c, -s, s, c
    T[:, :2, 3], T[:, 2, 3] = xy_m, z_m
    return T


class WorldBuilder:
    """Collects meshes, instances, footprints and spots of a world."""

    def __init__(self) -> None:
        self.meshes: list[Mesh] = []
        self.class_names: list[str] = ['']
        self.spots: list[Spot] = []
        self.obstacles: list[Rect] = []
        self.lamps: list[Lamp] = []

    def new_instance(self, class_name: str) -> int:
        """Return the number of a new instance."""
        self.class_names.append(class_name)
        return len(self.class_names) - 1

    def add(
        self,
        mesh: Mesh,
        T_world_thing: FloatArray,
        class_name: str = '',
        footprint: Rect | None = None,
    ) -> None:
        """Add a mesh: an instance if it has a class, an obstacle if it has a footprint."""
        if class_name:
            mesh = mesh.as_instance(self.new_instance(class_name))
        self.meshes.append(mesh.transformed(T_world_thing))
        if footprint is not None:
            self.obstacles.append(_moved(footprint, T_world_thing))

    def place(self, part: WorldBuilder, T_world_part: FloatArray) -> None:
        """Add meshes, instances, footprints and lamps of another builder, but not its spots."""
        mesh, others = part.mesh(), len(self.class_names) - 1
        instance = mesh.instance + np.where(mesh.instance > 0, others, 0).astype(np.uint8)
        self.class_names += part.class_names[1:]
        self.meshes.append(replace(mesh, instance=instance).transformed(T_world_part))
        self.obstacles += [_moved(rect, T_world_part) for rect in part.obstacles]
        self.lamps += [
            Lamp(se3.transform(T_world_part, lamp.points_m), lamp.strength) for lamp in part.lamps
        ]

    def add_spot(
        self,
        T_world_thing: FloatArray,
        position_m: tuple[float, float, float],
        stand_m: tuple[float, float],
        on_floor: bool = False,
    ) -> None:
        """Add a spot in the frame of `T_world_thing`; a person at `stand_m` faces it."""
        at = T_world_thing[:3, :3] @ np.array(position_m) + T_world_thing[:3, 3]
        stand = T_world_thing[:2, :2] @ np.array(stand_m) + T_world_thing[:2, 3]
        way = at[:2] - stand
        heading = float(np.arctan2(way[1], way[0]))
        place = (float(at[0]), float(at[1]), float(at[2]))
        self.spots.append(Spot(place, (float(stand[0]), float(stand[1])), heading, on_floor))

    def mesh(self) -> Mesh:
        """Return the union of all added meshes."""
        return merged(self.meshes)


def _moved(rect: Rect, T_a_b: FloatArray) -> Rect:
    """Return the bounding rectangle of a moved one."""
    x1, y1, x2, y2 = rect
    corners = np.array([[x1, y1], [x2, y1], [x1, y2], [x2, y2]])
    moved = corners @ T_a_b[:2, :2].T + T_a_b[:2, 3]
    (a, b), (c, d) = moved.min(0), moved.max(0)
    return float(a), float(b), float(c), float(d)
